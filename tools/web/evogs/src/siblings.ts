/** Sibling differences: psi lists of a step of refines that have `delta` (spec 7.1). */

import { PLACES, SIBLINGS, type Workspace } from "./workspace.js";

const MAX_SUM = 1 << 28;
const NONE = -1;

/**
 * For each of the `n` records the place of the record whose slot it was born from, or -1.
 * `slots` increase, so that record is an earlier one.
 */
export function siblingsOf(slots: Int32Array, n: number, bornFrom: Int32Array, workspace: Workspace): Int32Array {
  const firsts = workspace.integers(SIBLINGS, n);
  const places = workspace.integers(PLACES, n > 0 ? slots[n - 1] + 1 : 0);
  for (let i = 0; i < n; i++) {
    const parent = bornFrom[slots[i]];
    // The array is not cleared, since a tile may have far more slots than records: ask the record itself.
    const place = parent < 0 ? NONE : places[parent];
    firsts[i] = place >= 0 && place < i && slots[place] === parent ? place : NONE;
    places[slots[i]] = i;
  }
  return firsts;
}

/**
 * As `addSiblings`, of signed integers of a byte each, times `factor`: see `unpackSigned`. No product is above
 * 2^28.
 */
export function unpackSiblings(
  plane: Uint8Array,
  n: number,
  factor: number,
  firsts: Int32Array,
  values: Int32Array,
): boolean {
  let margin = 0;
  for (let i = 0; i < n; i++) {
    const byte = plane[i];
    const difference = Math.imul((byte >> 1) ^ -(byte & 1), factor);
    const first = firsts[i];
    if (first < 0) {
      values[i] = difference;
      continue;
    }
    const before = values[first];
    const own = (before - difference) | 0;
    const other = (before + difference) | 0;
    margin |= (MAX_SUM - own) | (MAX_SUM + own) | (MAX_SUM - other) | (MAX_SUM + other);
    values[i] = own;
    values[first] = other;
  }
  return margin >= 0;
}

/** The integers of a list of sibling differences, in place. False if one is out of range (R-7.1-2). */
export function addSiblings(values: Int32Array, n: number, firsts: Int32Array): boolean {
  // Negative once a number was out of range: none before it was, so neither sum leaves 32 bits unseen.
  let margin = 0;
  for (let i = 0; i < n; i++) {
    const first = firsts[i];
    if (first < 0) continue;
    const difference = values[i];
    const before = values[first];
    const own = (before - difference) | 0;
    const other = (before + difference) | 0;
    margin |= (MAX_SUM - own) | (MAX_SUM + own) | (MAX_SUM - other) | (MAX_SUM + other);
    values[i] = own;
    values[first] = other;
  }
  return margin >= 0;
}
