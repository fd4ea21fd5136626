/** FSE tables (RFC 8878, 4.1). An entry is symbol | bits << 8 | base of the next state << 16, 4 bytes. */

const COUNTS: usize = memory.data(256 * 2, 16);
const NEXT_STATE: usize = memory.data(256 * 2, 16);

/** The log of the table that `readTable` read last. */
export let tableLog: i32 = 0;

/** Fills a table from the counts of `n` symbols, 2 bytes each, where -1 means "less than 1". */
export function setCounts(entries: usize, log: i32, counts: usize, n: i32): void {
  const size: i32 = 1 << log;
  let high = size - 1;
  for (let s = 0; s < n; s++) {
    const count: i32 = load<i16>(counts + 2 * s);
    store<u16>(NEXT_STATE + 2 * s, max(count, 1));
    if (count === -1) store<u32>(entries + 4 * high--, s);
  }
  const step = (size >> 1) + (size >> 3) + 3;
  let at = 0;
  for (let s = 0; s < n; s++) {
    const count: i32 = load<i16>(counts + 2 * s);
    for (let i = 0; i < count; i++) {
      store<u32>(entries + 4 * at, s);
      do at = (at + step) & (size - 1);
      while (at > high);
    }
  }
  for (let i = 0; i < size; i++) {
    const s = load<u32>(entries + 4 * i);
    const x: i32 = load<u16>(NEXT_STATE + 2 * s);
    store<u16>(NEXT_STATE + 2 * s, x + 1);
    const bits = log - (31 - clz(x));
    store<u32>(entries + 4 * i, s | (bits << 8) | (((x << bits) - size) << 16));
  }
}

function peek(bit: u32, n: i32): i32 {
  return (load<u32>(bit >>> 3) >>> (bit & 7)) & ((1 << n) - 1);
}

/**
 * Reads the description of a table from `from..to`, and returns where it ends; 0 if it is corrupt, or has a log
 * above `maxLog`, or a symbol above `maxSymbol`. It looks at bytes behind `to`, but takes none.
 */
export function readTable(from: usize, to: usize, entries: usize, maxLog: i32, maxSymbol: i32): usize {
  let bit: u32 = (<u32>from) << 3;
  const endBit: u32 = (<u32>to) << 3;
  const log = peek(bit, 4) + 5;
  bit += 4;
  if (log > maxLog) return 0;
  let left = (1 << log) + 1;
  let n = 0;
  while (left > 1) {
    if (n > maxSymbol) return 0;
    // A value is 0 .. left. The lowest ones take a bit less.
    const width = 32 - clz(left);
    const threshold = 1 << (width - 1);
    const nShort = 2 * threshold - 1 - left;
    let value = peek(bit, width - 1);
    if (value < nShort) {
      bit += width - 1;
    } else {
      value = peek(bit, width);
      if (value >= threshold) value -= nShort;
      bit += width;
    }
    const count = value - 1;
    store<i16>(COUNTS + 2 * n++, count);
    left -= abs(count);
    if (count === 0) {
      let repeats: i32;
      do {
        repeats = peek(bit, 2);
        bit += 2;
        if (n + repeats > maxSymbol + 1 || bit > endBit) return 0;
        for (let i = 0; i < repeats; i++) store<i16>(COUNTS + 2 * n++, 0);
      } while (repeats === 3);
    }
    if (bit > endBit) return 0;
  }
  setCounts(entries, log, COUNTS, n);
  tableLog = log;
  return (bit + 7) >>> 3;
}
