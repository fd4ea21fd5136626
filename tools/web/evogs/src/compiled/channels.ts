/**
 * The channels of a component, through all of its steps (spec 7.3, 7.4): one after the other, so that the numbers
 * of a channel stay in the cache.
 */

import { MAX_DELTA, MAX_PRODUCT } from "../arithmetic.js";
import type { ChannelBlock } from "../channelBlock.js";
import { ADDS_ARE_YCOCG, PSI_IS_YCOCG } from "../lists.js";
import { FIRST_SH, classOf, groupOf } from "../model.js";
import { hasDelta } from "../planes.js";
import { type Quantisers, ROW_OF_ADDS } from "../quantisers.js";
import { type Box, type Range, rangeOf } from "../step.js";
import { type Engine, need } from "./engine.js";
import { type Lists, isZero, readSigned } from "./lists.js";
import type { Records } from "./records.js";

/** A step of a component. */
export interface Step {
  records: Records;
  /** Null if all integers are 0. */
  lists: Lists | null;
  /** Slots of the component before the step. */
  from: number;
}

/** The lists of psi or of adds of a step. */
interface Source {
  lists: Lists;
  /** The list of the first channel of the component. */
  list: number;
  n: number;
  isYcocg: boolean;
  /** The row of quantisers. */
  row: number;
  /** The records, of lists that may hold sibling differences. */
  records: Records | null;
}

/** Delta of a channel: where it is, and how far from 0 it is at most. */
interface Delta {
  at: number;
  furthest: number;
}

export class ChannelRun {
  /** Delta by record of the channels that are read together: three colours, or one. */
  private readonly deltas: number[];
  /** How far from 0 the numbers of each column are at most. */
  private readonly reach = [0, 0, 0];
  /** The same of the colours in `deltas`, without their factor. */
  private colours = 0;

  constructor(
    private readonly engine: Engine,
    private readonly quantisers: Quantisers,
    /** The first channel of the component. */
    private readonly first: number,
    private readonly steps: Step[],
    /** Slots behind all steps. */
    private readonly n: number,
    private readonly box: Box | null,
  ) {
    const longest = steps.reduce((most, { records }) => Math.max(most, records.nPsi, records.nAdds), 0);
    this.deltas = [0, 1, 2].map(() => engine.takeIntegers(longest));
  }

  /** Fills a block, channel after channel. */
  run(block: ChannelBlock): void {
    const { engine, n, first } = this;
    const data = engine.takeIntegers(block.nChannels * n);
    for (let k = 0; k < block.nChannels; ) {
      const together = first + k < FIRST_SH ? 1 : 3;
      this.reach.fill(0);
      for (const step of this.steps) {
        this.applyAdds(step, data + 4 * k * n, k, together);
        this.applyPsi(step, data + 4 * k * n, k, together);
      }
      k += together;
    }
    block.take(engine.at(data, block.nChannels * n).slice(), n);
  }

  /** Adds come behind second children. The numbers of channel k stand at `columns`, the others behind. */
  private applyAdds({ records, lists, from }: Step, columns: number, k: number, together: number): void {
    const { kernels, integers } = this.engine;
    const { nAdds: n, nSplits } = records;
    if (n === 0) return;
    const isYcocg = lists !== null && (lists.flags & ADDS_ARE_YCOCG) !== 0;
    const source = lists && { lists, list: lists.layout.adds, n, isYcocg, row: ROW_OF_ADDS, records: null };
    for (let c = 0; c < together; c++) {
      const x = columns + 4 * (c * this.n + from + nSplits);
      const delta = source && this.read(source, k, c);
      if (delta === null) this.engine.at(x, n).fill(0);
      else integers.copyWithin(x >> 2, delta.at >> 2, (delta.at >> 2) + n);
      const bounds = this.boundsOf(k + c, c, delta?.furthest ?? 0);
      if (bounds) need(kernels.areWithin(x, n, bounds.least, bounds.most));
    }
  }

  /** Refines and splits, then drops. */
  private applyPsi({ records, lists, from }: Step, columns: number, k: number, together: number): void {
    const { kernels } = this.engine;
    const { nPsi: n, psi, nSplits, splits, parents, nDrops, drops, label } = records;
    const isYcocg = lists !== null && (lists.flags & PSI_IS_YCOCG) !== 0;
    const source = lists && { lists, list: lists.layout.psi, n, isYcocg, row: 1 + label, records };
    for (let c = 0; c < together; c++) {
      const x = columns + 4 * c * this.n;
      const delta = source && this.read(source, k, c);
      if (delta === null) kernels.copySlots(x, from, parents, nSplits);
      else {
        let { furthest } = delta;
        if (nSplits > 0) {
          const { entries, shift, largest, indices } = records.alpha[groupOf(this.first + k + c)];
          const half = (1 << shift) >> 1;
          const most = MAX_PRODUCT - half;
          const product = Math.min(largest * furthest, most);
          if (product < largest * furthest) {
            need(kernels.areProductsWithin(splits, nSplits, delta.at, entries, indices, most));
          }
          kernels.writeSeconds(x, from, splits, parents, nSplits, delta.at, entries, shift, indices);
          furthest = Math.max(furthest, (product + half) / (1 << shift));
        }
        kernels.addDelta(x, psi, n, delta.at);
        const bounds = this.boundsOf(k + c, c, this.reach[c] + furthest);
        if (bounds) {
          need(kernels.areWithin(x + 4 * from, nSplits, bounds.least, bounds.most));
          need(kernels.areSlotsWithin(x, psi, n, bounds.least, bounds.most));
        }
      }
      kernels.clearSlots(x, drops, nDrops);
    }
  }

  /** Numbers of a column may now be as far from 0 as `reach`. The range to check; null if they are certainly in it. */
  private boundsOf(k: number, c: number, reach: number): Range | null {
    const range = rangeOf(this.first + k, this.box);
    if (this.box !== null && this.first + k < 3) return range;
    this.reach[c] = Math.min(Math.max(this.reach[c], reach), range.most);
    return reach <= range.most ? null : range;
  }

  /** Delta of channel k + c, of those from k on that are read together; null if all are 0. */
  private read({ lists, list, n, isYcocg, row, records }: Source, k: number, c: number): Delta | null {
    const { engine, deltas } = this;
    const { kernels } = engine;
    const { nClasses, mantissa, shift } = this.quantisers;
    const entry = row * nClasses + classOf(this.first + k);
    const factor = mantissa[entry] * 2 ** shift[entry];
    need(factor <= MAX_DELTA);
    const own = list + k + c;
    const at = deltas[c];
    const isOfColours = isYcocg && this.first + k >= FIRST_SH;
    let furthest: number;
    if (isOfColours) {
      if ([0, 1, 2].every((i) => isZero(lists, list + k + i))) return null;
      if (c === 0) {
        const [y, co, cg] = [0, 1, 2].map((i) => readSigned(engine, lists, list + k + i, 1, deltas[i]));
        // Each half is rounded down.
        this.colours = y + co + cg + 2;
        kernels.inverseYcocg(deltas[0], deltas[1], deltas[2], n);
      }
      furthest = this.colours * factor;
    } else {
      if (n === 0 || isZero(lists, own)) return null;
      furthest = readSigned(engine, lists, own, factor, at);
    }
    const hasSiblings = records !== null && records.nPairs > 0 && hasDelta(lists.coding[own]);
    if (hasSiblings) furthest *= records.growth;
    need(furthest <= MAX_DELTA);
    if (hasSiblings) kernels.addSiblings(at, records.pairs, records.nPairs);
    if (isOfColours) kernels.multiply(at, n, factor);
    return { at, furthest };
  }
}
