/**
 * The lists of packets (spec 5.9, 12.4): the one place that knows which lists a packet has,
 * in which order, and how many integers are in each.
 */

import { CORE, N_CORE, PALETTE, PICKS, channelsOf } from "./model.js";

/** Bits of the `flags` of a packet. */
export const PSI_IS_YCOCG = 1;
export const ADDS_ARE_YCOCG = 2;
/** Of picks only: refined and split slots have new picks too. */
export const PICKS_OF_CHANGED = 4;

/** The counts of the core row of the same tile and step; of the own row for the palette. */
export interface StepCounts {
  nAdds: number;
  nSplits: number;
  nRefines: number;
  nDrops: number;
}

/** The places of the lists of a packet. A place of a kind that a packet does not have is never asked for. */
export interface ListLayout {
  /** Integers in each list. */
  lengths: Uint32Array;
  gaps: number;
  kinds: number;
  /** The first of the five lists of alpha indices. */
  alpha: number;
  /** The first list of psi, and of adds or entries. A list for each channel of the component. */
  psi: number;
  adds: number;
  picks: number;
  /** The first list that may have `delta` (R-5.9-3). All behind it may, too. */
  firstDelta: number;
}

const N_GROUPS = 5;

/** The number of coding bytes of a packet. It does not depend on `flags`. */
export function listCount(component: number, shDegree: number): number {
  const { count } = channelsOf(component, shDegree);
  if (component === CORE) return 2 + N_GROUPS + 2 * N_CORE;
  if (component === PICKS) return 1;
  if (component === PALETTE) return count;
  return 2 * count;
}

export function layoutOf(component: number, shDegree: number, flags: number, counts: StepCounts): ListLayout {
  const { nAdds, nSplits, nRefines, nDrops } = counts;
  const nPsi = nSplits + nRefines;
  const lengths = new Uint32Array(listCount(component, shDegree));
  const layout = { lengths, gaps: -1, kinds: -1, alpha: -1, psi: -1, adds: -1, picks: -1, firstDelta: 0 };
  let n = 0;
  const place = (lists: number, integers: number): number => {
    lengths.fill(integers, n, n + lists);
    n += lists;
    return n - lists;
  };
  const { count } = channelsOf(component, shDegree);
  if (component === PICKS) {
    const ofChanged = flags & PICKS_OF_CHANGED ? nPsi : 0;
    layout.picks = place(1, ofChanged + nSplits + nAdds);
    layout.firstDelta = n;
    return layout;
  }
  if (component === PALETTE) {
    layout.adds = place(count, nAdds);
    return layout;
  }
  if (component === CORE) {
    const kindsUsed = Math.sign(nSplits) + Math.sign(nRefines) + Math.sign(nDrops);
    layout.gaps = place(1, nPsi + nDrops);
    layout.kinds = place(1, kindsUsed > 1 ? nPsi + nDrops : 0);
    layout.alpha = place(N_GROUPS, nSplits);
  }
  layout.psi = place(count, nPsi);
  layout.adds = place(count, nAdds);
  // Psi of a step of refines alone may hold sibling differences.
  layout.firstDelta = nSplits === 0 && nDrops === 0 ? layout.psi : layout.adds;
  return layout;
}
