/** Quantisers and children (spec 7.3). Products are checked before they are cut to 32 bits. */

import type { AlphaTable } from "./alpha.js";

const MAX_DELTA = 2 ** 28;
const MAX_PRODUCT = 2 ** 30;

/** Delta of each q, in place: q * M * 2^E. False if a |Delta| is above 2^28 (R-7.3-1). */
export function quantise(values: Int32Array, n: number, mantissa: number, shift: number): boolean {
  const most = Math.floor(Math.floor(MAX_DELTA / 2 ** shift) / mantissa);
  // If this is above 2^28, every q that is let through is 0.
  const factor = most === 0 ? 0 : mantissa << shift;
  for (let i = 0; i < n; i++) {
    const q = values[i];
    if (q > most || q < -most) return false;
    values[i] = Math.imul(q, factor);
  }
  return true;
}

/** Where numbers of a channel lie in an array, and their range: +-(2^30 - 1), or the box of the tile. */
export interface Column {
  x: Int32Array;
  /** The place of slot 0. */
  base: number;
  least: number;
  most: number;
}

/** The refines and splits of a step, for one channel. */
export interface Refinements {
  /** The slots of refines and splits, in order. */
  slots: Int32Array;
  n: number;
  /** Which of them are splits: places in `slots`, and -1 behind the last. */
  splits: Int32Array;
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
  const { x, base, least, most } = column;
  const { slots, n, splits, indices, first } = refinements;
  const { entries, shift } = refinements.table;
  const half = (1 << shift) >> 1;
  const bounds = productBounds(refinements.table);
  let a = entries[0];
  let bound = bounds[0];
  let isGood = true;
  let j = 0;
  let next = splits[0];
  for (let i = 0; i < n; i++) {
    const at = base + slots[i];
    const d = delta[i];
    const p = x[at];
    const value = (p + d) | 0;
    x[at] = value;
    if (value < least || value > most) isGood = false;
    if (i !== next) continue;
    if (indices !== null) {
      a = entries[indices[j]];
      bound = bounds[indices[j]];
    }
    // If the product is out of range, what is written for it does not matter.
    const second = (p - ((Math.imul(d, a) + half) >> shift)) | 0;
    if (d > bound || d < -bound || second < least || second > most) isGood = false;
    x[base + first + j] = second;
    next = splits[++j];
  }
  return isGood;
}

/** The largest |Delta| of each alpha: |a * Delta| + floor(2^K / 2) is at most 2^30 exactly up to there. */
function productBounds(table: AlphaTable): Int32Array {
  const half = (1 << table.shift) >> 1;
  return Int32Array.from(table.entries, (a) =>
    Math.min(MAX_DELTA, Math.floor((MAX_PRODUCT - half) / Math.abs(a))),
  );
}

/** Takes back what `refineSlots` added. Second children are behind the slots that were there. */
export function unrefineSlots(column: Column, slots: Int32Array, n: number, delta: Int32Array): void {
  for (let i = 0; i < n; i++) column.x[column.base + slots[i]] -= delta[i];
}

/** Second children where Delta is 0: copies of P. */
export function copySlots(
  column: Column,
  slots: Int32Array,
  splits: Int32Array,
  nSplits: number,
  first: number,
): void {
  const { x, base } = column;
  for (let j = 0; j < nSplits; j++) x[base + first + j] = x[base + slots[splits[j]]];
}
