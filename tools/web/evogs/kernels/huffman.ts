/** Huffman trees and streams of literals (RFC 8878, 4.2). */

import { bitLength, bitsAbove, lowBits } from "./bits";
import { readTable, tableLog } from "./fse";

const MAX_BITS = 11;
const WEIGHT_LOG = 6;

const WEIGHTS: usize = memory.data(256, 16);
const WEIGHT_TABLE: usize = memory.data(4 << WEIGHT_LOG, 16);
const STARTS: usize = memory.data(4 * (MAX_BITS + 2), 16);
/** Entries of the tree that was read last: bits | symbol << 8, so that an entry is a count for a shift too. */
const TABLE: usize = memory.data(2 << MAX_BITS, 16);
let log: i32 = 0;

/** Reads a tree description from `from..to`, and returns where it ends; 0 if it is corrupt. */
export function readTree(from: usize, to: usize): usize {
  if (from >= to) return 0;
  const head: i32 = load<u8>(from);
  let n: i32;
  let end: usize;
  if (head >= 128) {
    n = head - 127;
    end = from + 1 + ((n + 1) >> 1);
    if (end > to) return 0;
    for (let i = 0; i < n; i++) {
      const pair = load<u8>(from + 1 + (i >> 1));
      store<u8>(WEIGHTS + i, i & 1 ? pair & 15 : pair >> 4);
    }
  } else {
    end = from + 1 + head;
    if (end > to) return 0;
    n = readWeights(from + 1, end);
  }
  return n > 0 && buildTable(n) ? end : 0;
}

/** FSE-coded weights: two states take turns, until their bits are used up. Their number; 0 if they are corrupt. */
function readWeights(from: usize, to: usize): i32 {
  const start = readTable(from, to, WEIGHT_TABLE, WEIGHT_LOG, 255);
  if (start === 0) return 0;
  const tableBits = tableLog;
  let left = bitLength(start, to) - 2 * tableBits;
  // R-5.10-10: all bits of both initial states are there.
  if (left < 0) return 0;
  const states = bitsAbove(start, left);
  let now = load<u32>(WEIGHT_TABLE + 4 * lowBits(states >> tableBits, tableBits));
  let other = load<u32>(WEIGHT_TABLE + 4 * lowBits(states, tableBits));
  for (let n = 0; n <= 253; ) {
    store<u8>(WEIGHTS + n++, <u8>now);
    const bits: i32 = (now >>> 8) & 255;
    left -= bits;
    if (left < 0) {
      store<u8>(WEIGHTS + n++, <u8>other);
      return n;
    }
    const state = (now >>> 16) + lowBits(bitsAbove(start, left), bits);
    now = other;
    other = load<u32>(WEIGHT_TABLE + 4 * state);
  }
  return 0;
}

/** The table of the first `n` weights. The last weight follows from the others. */
function buildTable(n: i32): bool {
  memory.fill(STARTS, 0, 4 * (MAX_BITS + 2));
  let sum = 0;
  for (let s = 0; s < n; s++) {
    const w: i32 = load<u8>(WEIGHTS + s);
    if (w > MAX_BITS) return false;
    store<u32>(STARTS + 4 * w, load<u32>(STARTS + 4 * w) + 1);
    sum += w > 0 ? 1 << (w - 1) : 0;
  }
  if (sum === 0) return false;
  log = 32 - clz(sum);
  if (log > MAX_BITS) return false;
  const rest = (1 << log) - sum;
  if ((rest & (rest - 1)) !== 0) return false;
  const last = 32 - clz(rest);
  store<u8>(WEIGHTS + n, last);
  store<u32>(STARTS + 4 * last, load<u32>(STARTS + 4 * last) + 1);
  if (load<u32>(STARTS + 4) < 2) return false;
  let at: u32 = 0;
  for (let w = 1; w <= log; w++) {
    const count = load<u32>(STARTS + 4 * w);
    store<u32>(STARTS + 4 * w, at);
    at += count << (w - 1);
  }
  for (let s = 0; s <= n; s++) {
    const w: i32 = load<u8>(WEIGHTS + s);
    if (w === 0) continue;
    const from = load<u32>(STARTS + 4 * w);
    const to = from + (1 << (w - 1));
    store<u32>(STARTS + 4 * w, to);
    const entry = (log + 1 - w) | (s << 8);
    for (let i = from; i < to; i++) store<u16>(TABLE + 2 * i, entry);
  }
  return true;
}

/** Decodes the stream `from..to` to `out..end`. False unless it ends with its last bit. */
export function decodeStream(from: usize, to: usize, out: usize, end: usize): bool {
  return finishStream(from, bitLength(from, to), out, end);
}

/** Codes that 64 bits have room for, behind up to 7 bits that were taken before. */
const AT_ONCE: usize = 5;

/**
 * Decodes the last `bits` bits of the stream that begins at `from`. A number below 0 is no stream. It looks at up to
 * 8 bytes before it: what stands behind the last code does not matter.
 */
function finishStream(from: usize, bits: i32, out: usize, end: usize): bool {
  const shift: u64 = 64 - log;
  let left = bits;
  for (let o = out; o < end; ) {
    if (left <= 0) return false;
    const at = (left - 57) >> 3;
    let word = load<u64>(from + at) << (64 - left + 8 * at);
    for (const stop = min(o + AT_ONCE, end); o < stop; o++) {
      const entry: u64 = load<u16>(TABLE + ((<usize>(word >> shift)) << 1));
      // The number of a shift is taken modulo 64: the symbol does not count.
      word <<= entry;
      left -= <i32>entry & 255;
      store<u8>(o, entry >> 8);
    }
  }
  return left === 0;
}

/**
 * Decodes four streams, each of which ends where the next one begins, to `size` bytes at `out`: a quarter each,
 * rounded up. They take turns, since none of them waits for another.
 */
export function decodeFourStreams(
  from0: usize,
  from1: usize,
  from2: usize,
  from3: usize,
  to: usize,
  out: usize,
  size: usize,
): bool {
  let left0 = bitLength(from0, from1);
  let left1 = bitLength(from1, from2);
  let left2 = bitLength(from2, from3);
  let left3 = bitLength(from3, to);
  if ((left0 | left1 | left2 | left3) < 0) return false;
  const part = (size + 3) >> 2;
  const part2 = part + part;
  const part3 = part + part2;
  let o = out;
  if (min(min(left0, left1), min(left2, left3)) >= 64 && size > part3 + AT_ONCE) {
    const shift: u64 = 64 - log;
    // The last eight bytes that hold bits of each stream, with those that are not taken at the top. A 1 below
    // them, in place of the lowest bit, tells how many were.
    let at0 = from0 + ((left0 - 57) >> 3);
    let at1 = from1 + ((left1 - 57) >> 3);
    let at2 = from2 + ((left2 - 57) >> 3);
    let at3 = from3 + ((left3 - 57) >> 3);
    let bits0 = fillAt(at0, 64 - left0 + 8 * <i32>(at0 - from0));
    let bits1 = fillAt(at1, 64 - left1 + 8 * <i32>(at1 - from1));
    let bits2 = fillAt(at2, 64 - left2 + 8 * <i32>(at2 - from2));
    let bits3 = fillAt(at3, 64 - left3 + 8 * <i32>(at3 - from3));
    // The last part is the shortest.
    const last = out + size - part3 - AT_ONCE;
    while (o <= last && at0 >= from0 + 8 && at1 >= from1 + 8 && at2 >= from2 + 8 && at3 >= from3 + 8) {
      for (const stop = o + AT_ONCE; o < stop; o++) {
        const entry0: u64 = load<u16>(TABLE + ((<usize>(bits0 >> shift)) << 1));
        const entry1: u64 = load<u16>(TABLE + ((<usize>(bits1 >> shift)) << 1));
        const entry2: u64 = load<u16>(TABLE + ((<usize>(bits2 >> shift)) << 1));
        const entry3: u64 = load<u16>(TABLE + ((<usize>(bits3 >> shift)) << 1));
        bits0 <<= entry0;
        bits1 <<= entry1;
        bits2 <<= entry2;
        bits3 <<= entry3;
        store<u8>(o, entry0 >> 8);
        store<u8>(o + part, entry1 >> 8);
        store<u8>(o + part2, entry2 >> 8);
        store<u8>(o + part3, entry3 >> 8);
      }
      const taken0 = <i32>ctz(bits0);
      const taken1 = <i32>ctz(bits1);
      const taken2 = <i32>ctz(bits2);
      const taken3 = <i32>ctz(bits3);
      at0 -= taken0 >> 3;
      at1 -= taken1 >> 3;
      at2 -= taken2 >> 3;
      at3 -= taken3 >> 3;
      bits0 = fillAt(at0, taken0 & 7);
      bits1 = fillAt(at1, taken1 & 7);
      bits2 = fillAt(at2, taken2 & 7);
      bits3 = fillAt(at3, taken3 & 7);
    }
    left0 = 8 * <i32>(at0 - from0) + 64 - <i32>ctz(bits0);
    left1 = 8 * <i32>(at1 - from1) + 64 - <i32>ctz(bits1);
    left2 = 8 * <i32>(at2 - from2) + 64 - <i32>ctz(bits2);
    left3 = 8 * <i32>(at3 - from3) + 64 - <i32>ctz(bits3);
  }
  const end = out + size;
  return (
    finishStream(from0, left0, o, out + part) &&
    finishStream(from1, left1, min(o + part, end), min(out + part2, end)) &&
    finishStream(from2, left2, min(o + part2, end), min(out + part3, end)) &&
    finishStream(from3, left3, min(o + part3, end), end)
  );
}

function fillAt(at: usize, taken: i32): u64 {
  return (load<u64>(at) | 1) << taken;
}
