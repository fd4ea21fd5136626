/** Cuts by level (spec 3.6). */

import type { Directory } from "./directory.js";
import { CallerError } from "./faults.js";
import { CORE, PALETTE } from "./model.js";

/** A cut by level, and what follows from it before a packet is read. */
export interface Cut {
  /** Packets with a label of at most this are in the cut. */
  level: number;
  /** Slots of each tile after the cut. */
  slots: Uint32Array;
  /** Entries of the palette after the cut. */
  entries: number;
  /** Packets of SH and of picks that need the records of each core packet: 0 to 4. */
  users: Uint8Array;
}

/** The cut by `level`, or all packets. Throws a CallerError if the stream has no such level. */
export function cutByLevel(directory: Directory, level: number | undefined): Cut {
  const { header, packets } = directory;
  if (level !== undefined && !(Number.isInteger(level) && level >= 0 && level < header.nLevels)) {
    throw new CallerError(`the stream has no level ${level}`);
  }
  const cut: Cut = {
    level: level ?? header.nLevels - 1,
    slots: new Uint32Array(header.nTiles),
    entries: 0,
    users: new Uint8Array(packets.length),
  };
  for (let i = 0; i < packets.length; i++) {
    if (packets.label[i] > cut.level) continue;
    const component = packets.component[i];
    if (component === CORE) cut.slots[packets.tile[i]] = packets.slotsAfter[i];
    else if (component === PALETTE) cut.entries = packets.slotsAfter[i];
    else cut.users[packets.core[i]]++;
  }
  return cut;
}
