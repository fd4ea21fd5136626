/** Loops over bytes and integers, for src/compiled/: each is that of src/, for addresses in place of arrays. */

export { crc32 } from "./crc32";
export { decompress } from "./frame";
export { areBelow, inverseYcocg, undelta, unpack, unpackSigned } from "./planes";
export {
  addDelta,
  addDeltaEach,
  addSiblings,
  addSiblingsEach,
  areWithin,
  clearBytes,
  clearSlots,
  liveSlots,
  readSlots,
  runsOf,
  setSlots,
  siblingsOf,
  sortRecords,
  valuesOf,
  writeSeconds,
} from "./steps";
export { gather, gatherFour, mixFour, toFloats } from "./floats";

/** Where memory begins that no kernel has for itself. */
export const heapBase: usize = __heap_base;
