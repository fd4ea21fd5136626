/**
 * The channels of a component, through all of its steps (spec 7.3, 7.4): one after the other, so that the numbers
 * of a channel stay in the cache.
 */

import { MAX_DELTA, MAX_PRODUCT } from "../arithmetic.js";
import { ADDS_ARE_YCOCG, PSI_IS_YCOCG } from "../lists.js";
import { FIRST_SH, classOf, groupOf } from "../model.js";
import { hasDelta } from "../planes.js";
import { type Quantisers, ROW_OF_ADDS } from "../quantisers.js";
import { type Box, rangeOf } from "../step.js";
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
  /** How far from 0 the colours in `deltas` are at most. */
  private colours = 0;

  constructor(
    private readonly engine: Engine,
    private readonly quantisers: Quantisers,
    /** The first channel of the component, and how many it has. */
    private readonly first: number,
    private readonly nChannels: number,
    private readonly steps: Step[],
    /** Slots behind all steps. */
    private readonly n: number,
    private readonly box: Box | null,
  ) {
    const longest = steps.reduce((most, { records }) => Math.max(most, records.nPsi, records.nAdds), 0);
    this.deltas = [0, 1, 2].map(() => engine.takeIntegers(longest));
  }

  /** The address of the numbers, channel after channel. */
  run(): number {
    const { engine, n, first, nChannels } = this;
    const data = engine.takeIntegers(nChannels * n);
    for (let k = 0; k < nChannels; ) {
      const together = first + k < FIRST_SH ? 1 : 3;
      for (const step of this.steps) {
        this.applyAdds(step, data + 4 * k * n, k, together);
        this.applyPsi(step, data + 4 * k * n, k, together);
      }
      k += together;
    }
    return data;
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
      const { least, most } = rangeOf(this.first + k + c, this.box);
      need(kernels.areWithin(x, n, least, most));
    }
  }

  /** Refines and splits, then drops. */
  private applyPsi({ records, lists, from }: Step, columns: number, k: number, together: number): void {
    const { kernels } = this.engine;
    const { nPsi: n, psi, psiRuns, areSingle, nSplits, parents, splitRuns, nDrops, drops, label } = records;
    const isYcocg = lists !== null && (lists.flags & PSI_IS_YCOCG) !== 0;
    const source = lists && { lists, list: lists.layout.psi, n, isYcocg, row: 1 + label, records };
    for (let c = 0; c < together; c++) {
      const x = columns + 4 * c * this.n;
      const seconds = x + 4 * from;
      const delta = source && this.read(source, k, c);
      if (delta === null) kernels.gather(x, parents, nSplits, seconds);
      else {
        const { least, most } = rangeOf(this.first + k + c, this.box);
        if (nSplits > 0) {
          const { values, shift, largest } = records.alpha[groupOf(this.first + k + c)];
          need(largest * delta.furthest <= MAX_PRODUCT - ((1 << shift) >> 1));
          const { at, n } = splitRuns;
          need(kernels.writeSeconds(x, seconds, at, n, delta.at, values, shift, least, most));
        }
        need(
          areSingle
            ? kernels.addDeltaEach(x, psi, n, delta.at, least, most)
            : kernels.addDelta(x, psiRuns.at, psiRuns.n, delta.at, least, most),
        );
      }
      kernels.clearSlots(x, drops, nDrops);
    }
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
        this.colours = (y + co + cg + 2) * factor;
        kernels.inverseYcocg(deltas[0], deltas[1], deltas[2], n, factor);
      }
      furthest = this.colours;
    } else {
      if (n === 0 || isZero(lists, own)) return null;
      furthest = readSigned(engine, lists, own, factor, at);
    }
    const hasSiblings = records !== null && records.siblings.n > 0 && hasDelta(lists.coding[own]);
    if (hasSiblings) furthest *= records.growth;
    need(furthest <= MAX_DELTA);
    if (hasSiblings) {
      const { siblings, areSingle } = records;
      (areSingle ? kernels.addSiblingsEach : kernels.addSiblings)(at, siblings.at, siblings.n);
    }
    return { at, furthest };
  }
}
