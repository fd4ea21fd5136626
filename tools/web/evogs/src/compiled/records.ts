/** The records of the steps of a tile (spec 7.2), as addresses. */

import type { AlphaTables } from "../alpha.js";
import type { StepCounts } from "../lists.js";
import { type Engine, need } from "./engine.js";
import { type Lists, isZero, storedOf } from "./lists.js";

const N_GROUPS = 5;

/** What a step does to which slots. */
export interface Records extends StepCounts {
  label: number;
  /** Slots of refines and splits. */
  nPsi: number;
  psi: number;
  /** The splits: places in `psi`, and the slots there. */
  splits: number;
  parents: number;
  drops: number;
  /** Pairs of siblings, if lists may have their differences (7.1): see `siblingsOf` of the kernels. */
  pairs: number;
  nPairs: number;
  /** Differences that are added to one integer, at most, and one. */
  growth: number;
  /** For each group the table of alpha, the largest |a| of it, and the index of each split; 0 if all are 0. */
  alpha: { entries: number; shift: number; largest: number; indices: number }[];
}

/** A step without records: it has adds at most. */
export function noRecords(label: number, counts: StepCounts): Records {
  const nPsi = counts.nSplits + counts.nRefines;
  const nowhere = { psi: 0, splits: 0, parents: 0, drops: 0, pairs: 0 };
  return { ...counts, ...nowhere, label, nPsi, nPairs: 0, growth: 1, alpha: [] };
}

/** The records of a core packet, whose slots are among the first `nSlots`; `live` has a byte for each. */
export function readRecords(
  engine: Engine,
  lists: Lists,
  label: number,
  counts: StepCounts,
  live: number,
  nSlots: number,
  tables: AlphaTables,
): Records {
  const { kernels } = engine;
  const { layout } = lists;
  const { nSplits, nDrops } = counts;
  const records = noRecords(label, counts);
  const { nPsi } = records;
  const n = nPsi + nDrops;
  if (n === 0) return records;
  const slots = engine.takeIntegers(n);
  need(kernels.readSlots(storedOf(engine, lists, layout.gaps), n, live, nSlots, slots));
  if (layout.lengths[layout.kinds] > 0) {
    const kinds = storedOf(engine, lists, layout.kinds);
    const psi = engine.takeIntegers(nPsi + 1);
    const splits = engine.takeIntegers(nSplits + 1);
    const parents = engine.takeIntegers(nSplits + 1);
    const drops = engine.takeIntegers(nDrops + 1);
    need(kernels.sortRecords(kinds, slots, n, psi, splits, parents, drops, nPsi, nSplits, nDrops));
    Object.assign(records, { psi, splits, parents, drops });
  } else {
    // All are of one kind.
    const splits = engine.takeIntegers(nSplits);
    const places = engine.at(splits, nSplits);
    for (let j = 0; j < nSplits; j++) places[j] = j;
    Object.assign(records, { psi: slots, splits, parents: slots, drops: slots });
  }
  for (let group = 0; group < N_GROUPS && nSplits > 0; group++) {
    const { entries, shift } = tables.get(label, group);
    const list = layout.alpha + group;
    const indices = isZero(lists, list) ? 0 : storedOf(engine, lists, list);
    if (indices !== 0) need(kernels.areAtMost(indices, nSplits, entries.length - 1));
    const largest = entries.reduce((most, a) => Math.max(most, Math.abs(a)), 0);
    records.alpha.push({ entries: engine.put(entries), shift, largest, indices });
  }
  return records;
}

/** Finds the siblings among the records of a step of refines alone. `places` has room for all slots. */
export function findSiblings(engine: Engine, records: Records, bornFrom: number, places: number): void {
  const { nPsi, psi } = records;
  records.pairs = engine.takeIntegers(2 * nPsi + 1);
  const mark = engine.mark();
  const growth = engine.takeIntegers(nPsi);
  records.nPairs = engine.kernels.siblingsOf(psi, nPsi, bornFrom, places, growth, records.pairs);
  records.growth = engine.integers[(records.pairs + 8 * records.nPairs) >> 2];
  engine.release(mark);
}
