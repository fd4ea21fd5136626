/** Parts that are tested one by one. They may change with any version. */

export { inverseYcocg, undelta, unpack, unpackSigned, unzigzag } from "./planes.js";
export { quantise, refineSlots } from "./arithmetic.js";
export { RangeBuffer } from "./ranges.js";
export { DirtySlots } from "./dirty.js";
export { FrameDecompressor } from "./zstd/frame.js";
export { decompressFrame } from "./frames.js";
export { addSiblings, siblingsOf, unpackSiblings } from "./siblings.js";
export { Workspace } from "./workspace.js";
export { allowWebAssembly, withEngine } from "./compiled/engine.js";
export { decodeByEngine, floatsByEngine } from "./decode.js";
