/** Codes of lengths, and the predefined tables (RFC 8878, 3.1.1.3.2.1.1 and 3.1.1.3.2.2). */

import { type FseTable, newFseTable, setCounts } from "./fse.js";

function baselines(bits: Uint8Array, first: number): Uint32Array {
  const bases = new Uint32Array(bits.length);
  let base = first;
  for (let code = 0; code < bits.length; code++) {
    bases[code] = base;
    base += 2 ** bits[code];
  }
  return bases;
}

/** Extra bits of each literals length code. */
export const LL_BITS = new Uint8Array([
  0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
  16,
]);
/** Extra bits of each match length code. */
export const ML_BITS = new Uint8Array([
  0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2,
  3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,
]);
export const LL_BASE = baselines(LL_BITS, 0);
export const ML_BASE = baselines(ML_BITS, 3);

export const MAX_LL = 35;
export const MAX_OF = 31;
export const MAX_ML = 52;

const LL_COUNTS = [
  4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1, -1, -1, -1,
];
const ML_COUNTS = [
  1, 4, 3, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
  1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -1,
];
const OF_COUNTS = [1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1];

function predefined(log: number, counts: number[]): FseTable {
  const table = newFseTable(log);
  setCounts(table, log, counts, counts.length);
  return table;
}

export const LL_DEFAULT = predefined(6, LL_COUNTS);
export const ML_DEFAULT = predefined(6, ML_COUNTS);
export const OF_DEFAULT = predefined(5, OF_COUNTS);
