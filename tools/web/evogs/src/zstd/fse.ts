/** FSE tables (RFC 8878, 4.1). */

import { corrupt } from "./error.js";

/** A decoding table. An entry is symbol | bits << 8 | base of the next state << 16. */
export interface FseTable {
  log: number;
  entries: Uint32Array;
}

export function newFseTable(maxLog: number): FseTable {
  return { log: 0, entries: new Uint32Array(1 << maxLog) };
}

const counts = new Int16Array(256);
const nextState = new Uint16Array(256);

/** A table of one symbol that takes no bits (RLE_Mode). */
export function setSingle(table: FseTable, symbol: number): void {
  table.log = 0;
  table.entries[0] = symbol;
}

/** Fills a table from normalised counts, where -1 means "less than 1". */
export function setCounts(table: FseTable, log: number, probabilities: ArrayLike<number>, n: number): void {
  const size = 1 << log;
  const { entries } = table;
  table.log = log;
  let high = size - 1;
  for (let s = 0; s < n; s++) {
    nextState[s] = Math.max(probabilities[s], 1);
    if (probabilities[s] === -1) entries[high--] = s;
  }
  const step = (size >> 1) + (size >> 3) + 3;
  let at = 0;
  for (let s = 0; s < n; s++) {
    for (let i = 0; i < probabilities[s]; i++) {
      entries[at] = s;
      do at = (at + step) & (size - 1);
      while (at > high);
    }
  }
  for (let i = 0; i < size; i++) {
    const s = entries[i];
    const x = nextState[s]++;
    const bits = log - (31 - Math.clz32(x));
    entries[i] = s | (bits << 8) | (((x << bits) - size) << 16);
  }
}

/**
 * Reads the description of a table from `bytes[from..to)`, and returns where it ends.
 * It must have a log of at most maxLog, and no symbol above maxSymbol.
 */
export function readTable(
  bytes: Uint8Array,
  from: number,
  to: number,
  table: FseTable,
  maxLog: number,
  maxSymbol: number,
): number {
  let bit = 8 * from;
  const endBit = 8 * to;
  const peek = (n: number): number => {
    const at = bit >> 3;
    const word = byteAt(bytes, at, to) | (byteAt(bytes, at + 1, to) << 8) | (byteAt(bytes, at + 2, to) << 16);
    return (word >> (bit & 7)) & ((1 << n) - 1);
  };
  const log = peek(4) + 5;
  bit += 4;
  if (log > maxLog) corrupt("the log of an FSE table");
  let left = (1 << log) + 1;
  let n = 0;
  while (left > 1) {
    if (n > maxSymbol) corrupt("too many symbols in an FSE table");
    // A value is 0 .. left. The lowest ones take a bit less.
    const width = 32 - Math.clz32(left);
    const threshold = 1 << (width - 1);
    const nShort = 2 * threshold - 1 - left;
    let value = peek(width - 1);
    if (value < nShort) {
      bit += width - 1;
    } else {
      value = peek(width);
      if (value >= threshold) value -= nShort;
      bit += width;
    }
    const count = value - 1;
    counts[n++] = count;
    left -= Math.abs(count);
    if (count === 0) {
      let repeats: number;
      do {
        repeats = peek(2);
        bit += 2;
        if (n + repeats > maxSymbol + 1 || bit > endBit) corrupt("zeros of an FSE table");
        for (let i = 0; i < repeats; i++) counts[n++] = 0;
      } while (repeats === 3);
    }
    if (bit > endBit) corrupt("an FSE table is cut short");
  }
  setCounts(table, log, counts, n);
  return (bit + 7) >> 3;
}

function byteAt(bytes: Uint8Array, at: number, to: number): number {
  return at < to ? bytes[at] : 0;
}
