/** Quantisers and children (spec 7.3). Products are checked before they are cut to 32 bits. */

import type { AlphaTable } from "./alpha.js";

export const MAX_DELTA = 2 ** 28;
export const MAX_PRODUCT = 2 ** 30;

/** The largest |q| whose Delta, q * M * 2^E, is at most 2^28. */
export function furthestOf(mantissa: number, shift: number): number {
  return Math.floor(Math.floor(MAX_DELTA / 2 ** shift) / mantissa);
}

/** Delta of each q, in place. False if a |Delta| is above 2^28 (R-7.3-1). */
export function quantise(values: Int32Array, n: number, mantissa: number, shift: number): boolean {
  const most = furthestOf(mantissa, shift);
  // If this is above 2^28, every q that is let through is 0.
  const factor = most === 0 ? 0 : mantissa << shift;
  // Negative once a number was: a branch for each would be slower.
  let margin = 0;
  for (let i = 0; i < n; i++) {
    const q = values[i];
    margin |= (most - q) | (most + q);
    values[i] = Math.imul(q, factor);
  }
  return margin >= 0;
}

/** The numbers of a channel by slot, and their range: +-(2^30 - 1), or the box of the tile. */
export interface Column {
  x: Int32Array;
  least: number;
  most: number;
}

/** The refines and splits of a step, for one channel. */
export interface Refinements {
  /** The slots of refines and splits, in order. */
  slots: Int32Array;
  n: number;
  /** Which of them are splits: places in `slots`; and the slots there. */
  splits: Int32Array;
  parents: Int32Array;
  nSplits: number;
  /** The table of alpha, and the index of each split; null if all are 0. */
  table: AlphaTable;
  indices: Uint8Array | null;
  /** The slot of the first second child. */
  first: number;
}

/**
 * Adds Delta to the numbers of slots, and writes the second children P - round(alpha * Delta) of splits,
 * from P before the step. All is written, whatever its range: `unrefineSlots` can take it back.
 * False if a product or a number leaves its range (R-7.3-2, R-7.3-3, R-7.3-4).
 */
export function refineSlots(column: Column, refinements: Refinements, delta: Int32Array): boolean {
  const areSecondsGood = refinements.nSplits === 0 || writeSeconds(column, refinements, delta);
  const { slots, n } = refinements;
  return addDelta(column, slots, n, delta) && areSecondsGood;
}

// Two loops without a branch are faster than one with it: which records are splits cannot be foreseen.
// Distances to both ends of a range are below 2^32. If a number is outside, one of them is negative in 32 bits,
// even where the other one is so negative that it is not.

/** Adds Delta to the numbers of slots: `refineSlots` without splits. */
export function addDelta({ x, least, most }: Column, slots: Int32Array, n: number, delta: Int32Array): boolean {
  let margin = 0;
  for (let i = 0; i < n; i++) {
    const u = slots[i];
    const value = (x[u] + delta[i]) | 0;
    x[u] = value;
    margin |= (value - least) | (most - value);
  }
  return margin >= 0;
}

function writeSeconds(column: Column, refinements: Refinements, delta: Int32Array): boolean {
  const { x, least, most } = column;
  const { splits, parents, nSplits, indices, first, table } = refinements;
  const { entries, shift } = table;
  const half = (1 << shift) >> 1;
  const { least: bound } = boundsOf(table);
  let margin = 0;
  let productMargin = 0;
  let a = entries[0];
  for (let j = 0; j < nSplits; j++) {
    const d = delta[splits[j]];
    if (indices !== null) a = entries[indices[j]];
    // If the product is out of range, what is written for it does not matter.
    const second = (x[parents[j]] - ((Math.imul(d, a) + half) >> shift)) | 0;
    x[(first + j) | 0] = second;
    margin |= (second - least) | (most - second);
    productMargin |= (bound - d) | (bound + d);
  }
  return margin >= 0 && (productMargin >= 0 || areProductsGood(refinements, delta));
}

function areProductsGood({ splits, nSplits, table, indices }: Refinements, delta: Int32Array): boolean {
  const { bounds } = boundsOf(table);
  for (let j = 0; j < nSplits; j++) {
    const bound = bounds[indices === null ? 0 : indices[j]];
    if (Math.abs(delta[splits[j]]) > bound) return false;
  }
  return true;
}

interface Bounds {
  /** The largest |Delta| of each alpha. */
  bounds: Int32Array;
  /** The least of them. */
  least: number;
}

const boundsByTable = new WeakMap<AlphaTable, Bounds>();

/** |a * Delta| + floor(2^K / 2) is at most 2^30 exactly up to these |Delta|. */
function boundsOf(table: AlphaTable): Bounds {
  const known = boundsByTable.get(table);
  if (known !== undefined) return known;
  const half = (1 << table.shift) >> 1;
  const bounds = Int32Array.from(table.entries, (a) =>
    Math.min(MAX_DELTA, Math.floor((MAX_PRODUCT - half) / Math.abs(a))),
  );
  const made = { bounds, least: bounds.reduce((a, b) => Math.min(a, b)) };
  boundsByTable.set(table, made);
  return made;
}

/** Takes back what `refineSlots` added. Second children are behind the slots that were there. */
export function unrefineSlots(column: Column, slots: Int32Array, n: number, delta: Int32Array): void {
  for (let i = 0; i < n; i++) column.x[slots[i]] -= delta[i];
}

/** Second children where Delta is 0: copies of P. */
export function copySlots({ x }: Column, parents: Int32Array, nSplits: number, first: number): void {
  for (let j = 0; j < nSplits; j++) x[(first + j) | 0] = x[parents[j]];
}
