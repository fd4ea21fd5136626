/** The records of the steps of a tile (spec 7.2), as addresses. */

import type { AlphaTables } from "../alpha.js";
import type { StepCounts } from "../lists.js";
import { type Engine, need } from "./engine.js";
import { type Lists, isZero, storedOf } from "./lists.js";

const N_GROUPS = 5;
/** Integers of a run. */
const INTEGERS = 3;
/** Slots of a run that does not pay. */
const SHORT = 3;

/** Runs of pairs: see `runsOf` of the kernels. */
export interface Runs {
  at: number;
  n: number;
}

/** What a step does to which slots. */
export interface Records extends StepCounts {
  label: number;
  /** Slots of refines and splits; and their places and slots in runs. */
  nPsi: number;
  psi: number;
  psiRuns: Runs;
  /** Whether these runs are so short that single slots are faster. */
  areSingle: boolean;
  /** The slots of splits; and their places in `psi` and these slots in runs. */
  parents: number;
  splitRuns: Runs;
  drops: number;
  /** Pairs of siblings, if lists may have their differences (7.1): see `siblingsOf` of the kernels. */
  siblings: Runs;
  /** Differences that are added to one integer, at most, and one. */
  growth: number;
  /** For each group the numbers of alpha by split, and their shift and largest |a|. */
  alpha: { values: number; shift: number; largest: number }[];
}

/** A step without records: it has adds at most. */
export function noRecords(label: number, counts: StepCounts): Records {
  const nPsi = counts.nSplits + counts.nRefines;
  const { nAdds, nSplits, nRefines, nDrops } = counts;
  const none = { at: 0, n: 0 };
  const runs = { psiRuns: none, splitRuns: none, siblings: none };
  const own = { nAdds, nSplits, nRefines, nDrops, label, nPsi, areSingle: false, growth: 1, alpha: [] };
  return { ...own, ...runs, psi: 0, parents: 0, drops: 0 };
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
  // Where all are of one kind, each split is at its own place.
  let splits = 0;
  if (layout.lengths[layout.kinds] > 0) {
    const kinds = storedOf(engine, lists, layout.kinds);
    const psi = engine.takeIntegers(nPsi + 1);
    splits = engine.takeIntegers(nSplits + 1);
    const parents = engine.takeIntegers(nSplits + 1);
    const drops = engine.takeIntegers(nDrops + 1);
    need(kernels.sortRecords(kinds, slots, n, psi, splits, parents, drops, nPsi, nSplits, nDrops));
    Object.assign(records, { psi, parents, drops });
  } else {
    Object.assign(records, { psi: slots, parents: slots, drops: slots });
  }
  records.psiRuns = runsOf(engine, 0, records.psi, nPsi);
  records.areSingle = records.psiRuns.n * SHORT > nPsi;
  records.splitRuns = runsOf(engine, splits, records.parents, nSplits);
  for (let group = 0; group < N_GROUPS && nSplits > 0; group++) {
    const { entries, shift } = tables.get(label, group);
    const list = layout.alpha + group;
    const indices = isZero(lists, list) ? 0 : storedOf(engine, lists, list);
    if (indices !== 0) need(kernels.areWithin(indices, nSplits, 0, entries.length - 1));
    const largest = entries.reduce((most, a) => Math.max(most, Math.abs(a)), 0);
    const values = engine.takeIntegers(nSplits);
    kernels.valuesOf(engine.put(entries), indices, nSplits, values);
    records.alpha.push({ values, shift, largest });
  }
  return records;
}

/** Finds the siblings among the records of a step of refines alone. `places` has room for all slots. */
export function findSiblings(engine: Engine, records: Records, bornFrom: number, places: number): void {
  const { nPsi, psi, areSingle } = records;
  const at = engine.takeIntegers(INTEGERS * nPsi + 1);
  const mark = engine.mark();
  const growth = engine.takeIntegers(nPsi);
  const n = engine.kernels.siblingsOf(psi, nPsi, bornFrom, places, growth, areSingle ? 1 : nPsi, at);
  records.siblings = { at, n };
  records.growth = engine.integers[(at >> 2) + INTEGERS * n];
  engine.release(mark);
}

function runsOf(engine: Engine, places: number, slots: number, n: number): Runs {
  const at = engine.takeIntegers(INTEGERS * n);
  return { at, n: engine.kernels.runsOf(places, slots, n, at) };
}
