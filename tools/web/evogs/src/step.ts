/** A step of some channels of a tile (spec 7.4): core, or an SH band; and entries of a palette. */

import type { AlphaTables } from "./alpha.js";
import { type Column, copySlots, furthestOf, quantise, refineSlots, unrefineSlots } from "./arithmetic.js";
import { type ChannelBlock, NO_INTEGERS } from "./channelBlock.js";
import type { Directory } from "./directory.js";
import { ADDS_ARE_YCOCG, PSI_IS_YCOCG } from "./lists.js";
import { FIRST_SH, classOf, groupOf } from "./model.js";
import type { PacketLists } from "./packet.js";
import { inverseYcocg } from "./planes.js";
import { type Quantisers, ROW_OF_ADDS } from "./quantisers.js";
import type { StepPlan, StepRecords } from "./records.js";
import { addSiblings, siblingsOf, unpackSiblings } from "./siblings.js";
import { MAX_X } from "./tiles.js";
import { TRIPLE, type Workspace } from "./workspace.js";

/** The box of a tile: least and largest X of the position channels. */
export interface Box {
  least: ArrayLike<number>;
  most: ArrayLike<number>;
}

export function boxOf({ tiles: { boxMin, boxMax } }: Directory, t: number): Box {
  return { least: boxMin.subarray(3 * t, 3 * t + 3), most: boxMax.subarray(3 * t, 3 * t + 3) };
}

/** Delta of the channels of a packet, channel by channel, in increasing order. */
export class DeltaReader {
  private firsts: Int32Array | null = null;

  constructor(
    private readonly lists: PacketLists | null,
    private readonly quantisers: Quantisers,
    private readonly workspace: Workspace,
    /** The first channel of the component. */
    private readonly first: number,
    /** The first list: of psi, or of adds. */
    private readonly list: number,
    private readonly n: number,
    private readonly flag: number,
    private readonly row: number,
    /** Of psi: slots by record, and the slots that slots were born from, for lists that have `delta` (7.1). */
    private readonly slots: Int32Array | null = null,
    private readonly bornFrom: Int32Array = NO_INTEGERS,
  ) {}

  /** Delta of channel k of the component; null if all are 0; false if one is out of range. */
  read(k: number): Int32Array | null | false {
    const { lists, n } = this;
    if (lists === null || n === 0) return null;
    const channel = this.first + k;
    const { nClasses, mantissa, shift } = this.quantisers;
    const entry = this.row * nClasses + classOf(channel);
    let values: Int32Array;
    if (channel >= FIRST_SH && (lists.flags & this.flag) !== 0) {
      const colour = (channel - FIRST_SH) % 3;
      const triple = this.list + k - colour;
      if (lists.isZero(triple) && lists.isZero(triple + 1) && lists.isZero(triple + 2)) return null;
      if (colour === 0 && !this.readTriple(lists, triple)) return false;
      values = this.workspace.integers(TRIPLE + colour, n);
    } else {
      if (lists.isZero(this.list + k)) return null;
      values = this.workspace.integers(TRIPLE, n);
      const list = this.list + k;
      // Sums of products are products of sums: if none leaves its range, no sum without the factor does.
      if (lists.furthest(list) <= furthestOf(mantissa[entry], shift[entry])) {
        const factor = mantissa[entry] << shift[entry];
        const bytes = this.hasSiblings(list) ? lists.planeOfBytes(list) : null;
        const isGood =
          bytes === null
            ? lists.readSigned(list, values, factor) && this.addSiblingsOf(list, values)
            : unpackSiblings(bytes, n, factor, this.siblingPlaces(), values);
        if (isGood) return values;
      }
      if (!lists.readSigned(list, values)) return false;
    }
    if (!this.addSiblingsOf(this.list + k, values)) return false;
    return quantise(values, n, mantissa[entry], shift[entry]) && values;
  }

  /** Turns sibling differences into psi, if a list holds them. False if one is out of range. */
  private addSiblingsOf(list: number, values: Int32Array): boolean {
    return !this.hasSiblings(list) || addSiblings(values, this.n, this.siblingPlaces());
  }

  private hasSiblings(list: number): boolean {
    return this.slots !== null && this.lists !== null && this.lists.hasDelta(list);
  }

  private siblingPlaces(): Int32Array {
    this.firsts ??= siblingsOf(this.slots ?? NO_INTEGERS, this.n, this.bornFrom, this.workspace);
    return this.firsts;
  }

  private readTriple(lists: PacketLists, list: number): boolean {
    const arrays = [0, 1, 2].map((i) => this.workspace.integers(TRIPLE + i, this.n));
    for (let i = 0; i < 3; i++) if (!lists.readSigned(list + i, arrays[i])) return false;
    inverseYcocg(arrays[0], arrays[1], arrays[2], this.n);
    return true;
  }
}

/** The least and the largest number that a channel may have. */
export interface Range {
  least: number;
  most: number;
}

export function rangeOf(channel: number, box: Box | null): Range {
  if (box === null || channel >= 3) return { least: -MAX_X, most: MAX_X };
  return { least: box.least[channel], most: box.most[channel] };
}

function columnOf(block: ChannelBlock, k: number, channel: number, box: Box | null): Column {
  return { x: block.room(k), ...rangeOf(channel, box) };
}

/** Writes adds or entries to the slots from `at` on. False if a number leaves its range. */
export function applyAdds(
  block: ChannelBlock,
  first: number,
  at: number,
  n: number,
  lists: PacketLists | null,
  quantisers: Quantisers,
  box: Box | null,
  workspace: Workspace,
): boolean {
  const list = lists?.layout.adds ?? 0;
  const reader = new DeltaReader(lists, quantisers, workspace, first, list, n, ADDS_ARE_YCOCG, ROW_OF_ADDS);
  for (let k = 0; k < block.nChannels; k++) {
    const { x, least, most } = columnOf(block, k, first + k, box);
    const delta = reader.read(k);
    if (delta === false) return false;
    if (delta === null) {
      if (n > 0 && (least > 0 || most < 0)) return false;
      x.fill(0, at, at + n);
      continue;
    }
    // Negative once a number was out of range: they are within 2^28, and the range is within 2^30.
    let margin = 0;
    for (let i = 0; i < n; i++) {
      const value = delta[i];
      x[(at + i) | 0] = value;
      margin |= (value - least) | (most - value);
    }
    if (margin < 0) return false;
  }
  return true;
}

/**
 * Applies refines and splits to all channels of a block, second children to the slots from block.count on.
 * `bornFrom` is that of the tile.
 * False if a number leaves its range: the slots that were there are then as before.
 * Drops are not done here, since nothing may fail behind them.
 */
export function applyPsi(
  block: ChannelBlock,
  first: number,
  plan: StepPlan,
  records: StepRecords,
  bornFrom: Int32Array,
  lists: PacketLists | null,
  quantisers: Quantisers,
  alpha: AlphaTables,
  box: Box | null,
  workspace: Workspace,
): boolean {
  const { psiSlots, nPsi, splits, parents, nSplits } = plan;
  const list = lists?.layout.psi ?? 0;
  const row = 1 + records.label;
  const reader = new DeltaReader(
    lists,
    quantisers,
    workspace,
    first,
    list,
    nPsi,
    PSI_IS_YCOCG,
    row,
    psiSlots,
    bornFrom,
  );
  let done = 0;
  const apply = (k: number): boolean => {
    const column = columnOf(block, k, first + k, box);
    const delta = reader.read(k);
    if (delta === false) return false;
    if (delta === null) {
      copySlots(column, parents, nSplits, block.count);
      return true;
    }
    const group = groupOf(first + k);
    const table = alpha.get(records.label, group);
    const indices = records.alpha[group];
    done = k + 1;
    const { count } = block;
    const refinements = { slots: psiSlots, n: nPsi, splits, parents, nSplits, table, indices, first: count };
    return refineSlots(column, refinements, delta);
  };
  for (let k = 0; k < block.nChannels; k++) {
    if (apply(k)) continue;
    // R-6.4-5: take back what was written. Delta is read again, since it is kept for one channel only.
    for (let u = 0; u < done; u++) {
      const delta = reader.read(u);
      if (delta) unrefineSlots(columnOf(block, u, first + u, box), psiSlots, nPsi, delta);
    }
    return false;
  }
  return true;
}

/** Empties the slots of drops in all channels of a block. */
export function applyDrops(block: ChannelBlock, plan: StepPlan): void {
  for (let k = 0; k < block.nChannels; k++) {
    const x = block.room(k);
    for (let i = 0; i < plan.nDrops; i++) x[plan.drops[i]] = 0;
  }
}
