/** Quantisers and children (spec 7.3). Products are checked before they are cut to 32 bits. */

import type { AlphaTable } from "./alpha.js";

const MAX_DELTA = 2 ** 28;
const MAX_PRODUCT = 2 ** 30;

/** Delta of each q, in place: q * M * 2^E. False if a |Delta| is above 2^28 (R-7.3-1). */
export function quantise(values: Int32Array, n: number, mantissa: number, shift: number): boolean {
  const most = Math.floor(Math.floor(MAX_DELTA / 2 ** shift) / mantissa);
  const factor = mantissa * 2 ** shift;
  for (let i = 0; i < n; i++) {
    const q = values[i];
    if (q > most || q < -most) return false;
    values[i] = q * factor;
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

/** Adds Delta to the numbers of slots. All are written; false if one leaves its range. */
export function refineSlots(column: Column, slots: Int32Array, n: number, delta: Int32Array): boolean {
  const { x, base, least, most } = column;
  let isGood = true;
  for (let i = 0; i < n; i++) {
    const at = base + slots[i];
    const value = x[at] + delta[i];
    x[at] = value;
    if (value < least || value > most) isGood = false;
  }
  return isGood;
}

/** Takes back what `refineSlots` added. */
export function unrefineSlots(column: Column, slots: Int32Array, n: number, delta: Int32Array): void {
  for (let i = 0; i < n; i++) column.x[column.base + slots[i]] -= delta[i];
}

/**
 * Second children P - round(alpha * Delta), from P before the step, to the slots from `first` on.
 * `splits` are the splits among the n numbers of `slots` and `delta`; `indices` are those of alpha,
 * null for 0. False if a product or a child leaves its range (R-7.3-2, R-7.3-3).
 */
export function splitSlots(
  column: Column,
  slots: Int32Array,
  splits: Int32Array,
  nSplits: number,
  delta: Int32Array,
  table: AlphaTable,
  indices: Uint8Array | null,
  first: number,
): boolean {
  const { x, base, least, most } = column;
  const { entries, shift } = table;
  const half = (1 << shift) >> 1;
  const maxProduct = MAX_PRODUCT - half;
  for (let j = 0; j < nSplits; j++) {
    const i = splits[j];
    const product = delta[i] * (indices === null ? entries[0] : entries[indices[j]]);
    if (product > maxProduct || product < -maxProduct) return false;
    const value = x[base + slots[i]] - ((product + half) >> shift);
    if (value < least || value > most) return false;
    x[base + first + j] = value;
  }
  return true;
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
