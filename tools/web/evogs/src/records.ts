/** The records of a step: slots, kinds and alpha of its core packet (spec 7.2). */

import type { AlphaTables } from "./alpha.js";
import { StreamError, check } from "./faults.js";
import type { StepCounts } from "./lists.js";
import { DROP, REFINE, SPLIT } from "./model.js";
import type { PacketLists } from "./packet.js";
import { DROPS, PARENTS, PLAIN, PSI_SLOTS, SPLITS, type Workspace } from "./workspace.js";

const N_GROUPS = 5;

/** Records in order of slot. They are kept until no packet of the step needs them: 6 bytes each. */
export interface StepRecords {
  label: number;
  counts: StepCounts;
  slots: Int32Array;
  /** The kind of each record; null if all are of `kind`. */
  kinds: Uint8Array | null;
  kind: number;
  /** For each group the alpha indices of the splits; null if all are 0. Bands need those of SH. */
  alpha: (Uint8Array | null)[];
}

/** What is done to which slots. The arrays are those of a workspace. */
export interface StepPlan {
  /** Slots of refines and splits. */
  psiSlots: Int32Array;
  nPsi: number;
  /** The splits: places in psiSlots, and the slots there. */
  splits: Int32Array;
  parents: Int32Array;
  nSplits: number;
  drops: Int32Array;
  nDrops: number;
  nAdds: number;
}

/**
 * The records of a core packet; `lists` is null for one of size 0. `live` has a 1 for each live slot.
 * Throws E_SLOT, E_KIND, E_INDEX at `offset`.
 */
export function readRecords(
  lists: PacketLists | null,
  counts: StepCounts,
  label: number,
  live: Uint8Array,
  nSlots: number,
  tables: AlphaTables,
  workspace: Workspace,
  offset: number,
): StepRecords {
  const { nSplits, nRefines, nDrops } = counts;
  const n = nSplits + nRefines + nDrops;
  const kind = nSplits > 0 ? SPLIT : nRefines > 0 ? REFINE : DROP;
  const slots = new Int32Array(n);
  const records: StepRecords = { label, counts, slots, kinds: null, kind, alpha: new Array(N_GROUPS).fill(null) };
  if (lists === null || n === 0) return records;
  const { layout } = lists;

  const plain = workspace.integers(PLAIN, n);
  lists.read(layout.gaps, plain);
  let slot = -1;
  for (let i = 0; i < n; i++) {
    // A gap is below 2^24 and a slot is below nSlots, so the sum stays small.
    slot = (slot + plain[i] + 1) | 0;
    if (slot >= nSlots || live[slot] !== 1) throw new StreamError("E_SLOT", offset);
    slots[i] = slot;
  }
  if (lists.length(layout.kinds) > 0) {
    lists.read(layout.kinds, plain);
    records.kinds = readKinds(plain, n, counts, offset);
  }
  for (let group = 0; group < N_GROUPS && nSplits > 0; group++) {
    if (lists.isZero(layout.alpha + group)) continue;
    lists.read(layout.alpha + group, plain);
    const size = tables.get(label, group).entries.length;
    const indices = new Uint8Array(nSplits);
    for (let j = 0; j < nSplits; j++) {
      if (plain[j] >= size) throw new StreamError("E_INDEX", offset, "an alpha index");
      indices[j] = plain[j];
    }
    records.alpha[group] = indices;
  }
  return records;
}

function readKinds(stored: Int32Array, n: number, counts: StepCounts, offset: number): Uint8Array {
  const kinds = new Uint8Array(n);
  const found = [0, 0, 0];
  for (let i = 0; i < n; i++) {
    check(stored[i] <= DROP, "E_KIND", offset);
    kinds[i] = stored[i];
    found[kinds[i]]++;
  }
  const { nRefines, nSplits, nDrops } = counts;
  check(found[REFINE] === nRefines && found[SPLIT] === nSplits && found[DROP] === nDrops, "E_KIND", offset);
  return kinds;
}

/** Sorts the records by what they do. The plan lasts until the next one. */
export function planOf(records: StepRecords, workspace: Workspace): StepPlan {
  const { slots, kinds, counts } = records;
  const { nSplits, nDrops, nAdds } = counts;
  const nPsi = nSplits + counts.nRefines;
  const splits = workspace.integers(SPLITS, nSplits);
  if (kinds === null) {
    for (let j = 0; j < nSplits; j++) splits[j] = j;
    return { psiSlots: slots, nPsi, splits, parents: slots, nSplits, drops: slots, nDrops, nAdds };
  }
  // What a record does cannot be foreseen, so there is no branch: each is written to all lists, and only one
  // of them grows. They have a place more for it.
  const psiSlots = workspace.integers(PSI_SLOTS, nPsi + 1);
  const parents = workspace.integers(PARENTS, nSplits + 1);
  const places = workspace.integers(SPLITS, nSplits + 1);
  const drops = workspace.integers(DROPS, nDrops + 1);
  let i = 0;
  let j = 0;
  let k = 0;
  for (let r = 0; r < slots.length; r++) {
    const slot = slots[r];
    const own = kinds[r];
    psiSlots[i] = slot;
    parents[j] = slot;
    places[j] = i;
    drops[k] = slot;
    i += own === DROP ? 0 : 1;
    j += own === SPLIT ? 1 : 0;
    k += own === DROP ? 1 : 0;
  }
  return { psiSlots, nPsi, splits: places, parents, nSplits, drops, nDrops, nAdds };
}
