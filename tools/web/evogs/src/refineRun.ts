/**
 * Packets of a tile and component, one after the other in their chain, that only refine: applied channel by
 * channel. The packets of a level are spread over all slots, so each of them passes through all numbers of a
 * channel: those of one channel stay in the cache, those of all do not.
 */

import { addDelta } from "./arithmetic.js";
import type { ChannelBlock } from "./channelBlock.js";
import { CORE, FIRST_SH, PICKS } from "./model.js";
import { type Box, type DeltaReader, columnOf } from "./step.js";

/** The refines of a packet. */
export interface Refines {
  slots: Int32Array;
  reader: DeltaReader;
}

/** False if a number leaves its range. The block is then of no use. */
export function applyRefines(block: ChannelBlock, first: number, run: Refines[], box: Box | null): boolean {
  for (let k = 0; k < block.nChannels; ) {
    // A reader keeps the three colours of a coefficient until it is asked for the next one.
    const end = first + k < FIRST_SH ? k + 1 : k + 3;
    for (const { slots, reader } of run) {
      for (let channel = k; channel < end; channel++) {
        const delta = reader.read(channel);
        if (delta === false) return false;
        if (delta === null) continue;
        if (!addDelta(columnOf(block, channel, first + channel, box), slots, slots.length, delta)) return false;
      }
    }
    k = end;
  }
  return true;
}

/** Records of a run, at most: their planes are all kept. A packet with more is a run of its own. */
const MOST_RECORDS = 1 << 18;

/** What is asked of a packet table. */
interface Rows {
  component: Uint8Array;
  core: Int32Array;
  next: Int32Array;
  label: Uint8Array;
  size: Uint32Array;
  nAdds: Uint32Array;
  nSplits: Uint32Array;
  nRefines: Uint32Array;
  nDrops: Uint32Array;
}

/**
 * The packets from `i` on that are applied as one, of those up to a level: at least `i` itself.
 * `isDone` has a 1 for each packet that was applied: those of a band wait for core.
 */
export function runFrom(packets: Rows, i: number, level: number, isDone: Uint8Array): number[] {
  const run = [i];
  if (!onlyRefines(packets, i)) return run;
  let n = packets.nRefines[packets.core[i]];
  for (let p = packets.next[i]; p >= 0 && packets.label[p] <= level && onlyRefines(packets, p); ) {
    if (packets.component[p] !== CORE && isDone[packets.core[p]] === 0) break;
    n += packets.nRefines[packets.core[p]];
    if (n > MOST_RECORDS) break;
    run.push(p);
    p = packets.next[p];
  }
  return run;
}

/** Whether a packet is of core or of a band, has bytes, and has records of refines alone. */
function onlyRefines({ component, size, core, nAdds, nSplits, nRefines, nDrops }: Rows, i: number): boolean {
  const c = core[i];
  if (component[i] >= PICKS || size[i] === 0) return false;
  return nRefines[c] > 0 && nAdds[c] === 0 && nSplits[c] === 0 && nDrops[c] === 0;
}
