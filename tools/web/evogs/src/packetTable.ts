/** `PACK`: the packet table (spec 5.6, 12.3). */

import { viewOf } from "./bytes.js";
import type { Chunk } from "./chunks.js";
import { check } from "./faults.js";
import { HEADER_SIZE, type Header } from "./header.js";
import { LimitChecker, type Limits } from "./limits.js";
import { CORE, N_COMPONENTS, PALETTE, PICKS, hasComponent } from "./model.js";

const ROW_SIZE = 36;
const NONE = -1;

/** The rows, as arrays with an element for each packet, and what follows from them. */
export class PacketTable {
  readonly tile: Uint32Array;
  readonly component: Uint8Array;
  readonly size: Uint32Array;
  readonly nAdds: Uint32Array;
  readonly nSplits: Uint32Array;
  readonly nRefines: Uint32Array;
  readonly nDrops: Uint32Array;
  /** A hint (5.6). 0xFFFFFFFF means unknown. */
  readonly error: Uint32Array;
  readonly crc: Uint32Array;
  /** The offset in the file. Exact below 2^53: bytes behind that never come. */
  readonly offset: Float64Array;
  /** The number of the step. */
  readonly step: Uint32Array;
  /** The label (3.5): the level of the core packet, or of the row itself in the palette. */
  readonly label: Uint8Array;
  /** The core packet of the same tile and step, itself for core, -1 for the palette. */
  readonly core: Int32Array;
  /** The last packet of the palette that a packet of picks requires, with all before it (12.2). -1: it requires none. */
  readonly palette: Int32Array;
  /** The next packet of the chain, or -1. */
  readonly next: Int32Array;
  /** Slots of the tile after the step. Entries of the palette after the packet, if it is of the palette. */
  readonly slotsAfter: Uint32Array;
  /** The first packet of each chain, or -1. A chain is tile * 6 + component; that of the palette is 5. */
  readonly first: Int32Array;
  /** Where the file ends. Exact below 2^53. */
  end = 0;

  constructor(
    readonly length: number,
    nTiles: number,
  ) {
    const u32 = () => new Uint32Array(length);
    this.tile = u32();
    this.component = new Uint8Array(length);
    this.size = u32();
    this.nAdds = u32();
    this.nSplits = u32();
    this.nRefines = u32();
    this.nDrops = u32();
    this.error = u32();
    this.crc = u32();
    this.offset = new Float64Array(length);
    this.step = u32();
    this.label = new Uint8Array(length);
    this.core = new Int32Array(length).fill(NONE);
    this.palette = new Int32Array(length).fill(NONE);
    this.next = new Int32Array(length).fill(NONE);
    this.slotsAfter = u32();
    this.first = new Int32Array(Math.max(nTiles, 1) * N_COMPONENTS).fill(NONE);
  }

  /** The last packet that begins at or before an offset of the file, or 0. */
  at(offset: number): number {
    let low = 0;
    let high = this.length;
    while (high - low > 1) {
      const middle = (low + high) >>> 1;
      if (this.offset[middle] <= offset) low = middle;
      else high = middle;
    }
    return low;
  }

  /** The chain of a packet. */
  chainOf(i: number): number {
    const component = this.component[i];
    return component === PALETTE ? PALETTE : this.tile[i] * N_COMPONENTS + component;
  }

  /** The entries that a packet of picks may pick: they are the first of the palette (R-7.2-4). */
  entriesFor(i: number): number {
    const last = this.palette[i];
    return last === NONE ? 0 : this.slotsAfter[last];
  }
}

/** What is counted while the rows are read. */
interface Running {
  /** The last row and the number of rows of each chain. */
  last: Int32Array;
  steps: Uint32Array;
  /** Live splats of each tile, after the rows so far. */
  live: Float64Array;
  /** Slots of each tile. Slots and entries of all. */
  tileSlots: Float64Array;
  entries: number;
  slots: number;
  /** The last row of the palette up to each level below that of the last row so far, or -1. */
  paletteUpTo: Int32Array;
}

/** Reads the table, with the checks of 6.1, step 3. Throws a StreamError at `PACK`, or at 0 for R-5.1-8. */
export function parsePacketTable(chunk: Chunk, header: Header, limits: Limits = {}): PacketTable {
  const n = header.nPackets;
  check(chunk.body.length === n * ROW_SIZE, "E_CHUNK", chunk.offset, "size of PACK");
  const table = new PacketTable(n, header.nTiles);
  const running: Running = {
    last: new Int32Array(table.first.length).fill(NONE),
    steps: new Uint32Array(table.first.length),
    live: new Float64Array(header.nTiles),
    tileSlots: new Float64Array(header.nTiles),
    entries: 0,
    slots: 0,
    paletteUpTo: new Int32Array(header.nLevels).fill(NONE),
  };
  const checker = new LimitChecker(header.tier, limits);
  const view = viewOf(chunk.body);
  let low = 0;
  let high = 0;
  for (let i = 0; i < n; i++) {
    table.offset[i] = HEADER_SIZE + header.chunksSize + high * 2 ** 32 + low;
    parseRow(table, i, view, chunk.offset, header, running, checker);
    low += table.size[i];
    if (low >= 2 ** 32) {
      low -= 2 ** 32;
      high++;
    }
  }
  check(low === header.dataSizeLow && high === header.dataSizeHigh, "E_HEADER", 0, "data_size (R-5.1-8)");
  table.end = HEADER_SIZE + header.chunksSize + header.dataSize;
  return table;
}

/** Row `i`, its checks in the order of 6.1. */
function parseRow(
  table: PacketTable,
  i: number,
  view: DataView,
  at: number,
  header: Header,
  running: Running,
  checker: LimitChecker,
): void {
  const row = i * ROW_SIZE;
  const tile = view.getUint32(row, true);
  const component = view.getUint8(row + 4);
  const level = view.getUint8(row + 5);
  const size = view.getUint32(row + 8, true);
  const nAdds = view.getUint32(row + 12, true);
  const nSplits = view.getUint32(row + 16, true);
  const nRefines = view.getUint32(row + 20, true);
  const nDrops = view.getUint32(row + 24, true);
  check(view.getUint16(row + 6, true) === 0, "E_RESERVED", at);

  const isKnown = hasComponent(component, header.shDegree, header.hasPalette);
  check(tile < header.nTiles && isKnown, "E_CHAIN", at, "tile or component");
  table.tile[i] = tile;
  table.component[i] = component;
  const chain = table.chainOf(i);
  const step = running.steps[chain];
  const before = running.last[chain];
  const isOwn = component === CORE || component === PALETTE;
  if (isOwn) {
    const floor = before === NONE ? 0 : table.label[before];
    check(level < header.nLevels && level >= floor, "E_CHAIN", at, "level");
    check(component === CORE || nSplits + nRefines + nDrops === 0, "E_COUNT", at, "counts");
    const isEmpty = nAdds + nSplits + nRefines + nDrops === 0;
    check((size === 0) === isEmpty, "E_COUNT", at, "size");
    table.label[i] = level;
    table.core[i] = component === CORE ? i : NONE;
  } else {
    check(running.steps[tile * N_COMPONENTS + CORE] > step, "E_CHAIN", at, "an SH row before its core row");
    check(level + nAdds + nSplits + nRefines + nDrops === 0, "E_COUNT", at, "counts");
    const core = before === NONE ? table.first[tile * N_COMPONENTS] : table.next[table.core[before]];
    table.core[i] = core;
    table.label[i] = table.label[core];
  }
  if (component === CORE) {
    check(nSplits + nRefines + nDrops <= running.live[tile], "E_COUNT", at, "live splats before the step");
  }
  const records = nAdds + nSplits + nRefines + nDrops;
  check(records <= 16 * size, "E_AMPLIFICATION", at);
  table.crc[i] = view.getUint32(row + 32, true);
  check(size > 0 || table.crc[i] === 0, "E_CRC", at);
  if (component === PALETTE) {
    check(tile === 0, "E_CHAIN", at, "tile of a palette row (R-5.6-10)");
    // Levels do not fall (R-5.6-3): no level below this one has more rows.
    if (before !== NONE) running.paletteUpTo.fill(before, table.label[before], level);
  } else if (component === PICKS) {
    const last = running.last[PALETTE];
    const isOfAll = last === NONE || table.label[i] >= table.label[last];
    table.palette[i] = isOfAll ? last : running.paletteUpTo[table.label[i]];
  }

  running.steps[chain] = step + 1;
  running.last[chain] = i;
  checker.check("tile_steps", step + 1, at);
  const made = nAdds + nSplits;
  if (component === CORE) {
    running.live[tile] += made - nDrops;
    running.tileSlots[tile] += made;
    checker.check("tile_slots", running.tileSlots[tile], at);
    table.slotsAfter[i] = running.tileSlots[tile];
  } else if (component === PALETTE) {
    running.entries += made;
    checker.check("tile_slots", running.entries, at);
    table.slotsAfter[i] = running.entries;
  } else {
    table.slotsAfter[i] = table.slotsAfter[table.core[i]];
  }
  running.slots += made;
  checker.check("slots", running.slots, at);

  table.size[i] = size;
  table.nAdds[i] = nAdds;
  table.nSplits[i] = nSplits;
  table.nRefines[i] = nRefines;
  table.nDrops[i] = nDrops;
  table.error[i] = view.getUint32(row + 28, true);
  table.step[i] = step;
  if (before === NONE) table.first[chain] = i;
  else table.next[before] = i;
}
