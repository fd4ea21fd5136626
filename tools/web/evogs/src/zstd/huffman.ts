/** Huffman trees and streams of literals (RFC 8878, 4.2). */

import { BackwardBits, bitLength } from "./bits.js";
import { corrupt } from "./error.js";
import { newFseTable, readTable } from "./fse.js";

const MAX_BITS = 11;
const WEIGHT_LOG = 6;

/** A decoding table. An entry is symbol | bits << 8. */
export interface HuffmanTable {
  log: number;
  entries: Uint16Array;
}

export function newHuffmanTable(): HuffmanTable {
  return { log: 0, entries: new Uint16Array(1 << MAX_BITS) };
}

const weights = new Uint8Array(256);
const weightTable = newFseTable(WEIGHT_LOG);
const starts = new Uint32Array(MAX_BITS + 2);

/** Reads a tree description from `bytes[from..to)`, and returns where it ends. */
export function readTree(
  bytes: Uint8Array,
  view: DataView,
  from: number,
  to: number,
  table: HuffmanTable,
): number {
  if (from >= to) corrupt("no Huffman tree");
  const head = bytes[from];
  let n: number;
  let end: number;
  if (head >= 128) {
    n = head - 127;
    end = from + 1 + ((n + 1) >> 1);
    if (end > to) corrupt("a Huffman tree is cut short");
    for (let i = 0; i < n; i++) {
      const pair = bytes[from + 1 + (i >> 1)];
      weights[i] = i & 1 ? pair & 15 : pair >> 4;
    }
  } else {
    end = from + 1 + head;
    if (end > to) corrupt("a Huffman tree is cut short");
    n = readWeights(bytes, view, from + 1, end);
  }
  buildTable(table, n);
  return end;
}

/** FSE-coded weights: two states take turns, until their bits are used up. */
function readWeights(bytes: Uint8Array, view: DataView, from: number, to: number): number {
  const start = readTable(bytes, from, to, weightTable, WEIGHT_LOG, 255);
  const bits = new BackwardBits(view, bytes, start, to);
  const { log, entries } = weightTable;
  // R-5.10-10: all bits of both initial states are there.
  let now = entries[bits.read(log)];
  let other = entries[bits.read(log)];
  let n = 0;
  for (;;) {
    if (n > 253) corrupt("too many Huffman weights");
    weights[n++] = now & 255;
    const state = (now >>> 16) + bits.readPast((now >>> 8) & 255);
    if (bits.left < 0) {
      weights[n++] = other & 255;
      return n;
    }
    now = other;
    other = entries[state];
  }
}

/** The table of the first `n` weights. The last weight follows from the others. */
function buildTable(table: HuffmanTable, n: number): void {
  let sum = 0;
  starts.fill(0);
  for (let s = 0; s < n; s++) {
    if (weights[s] > MAX_BITS) corrupt("a Huffman weight");
    starts[weights[s]]++;
    sum += weights[s] > 0 ? 1 << (weights[s] - 1) : 0;
  }
  if (sum === 0) corrupt("a Huffman tree without weights");
  const log = 32 - Math.clz32(sum);
  if (log > MAX_BITS) corrupt("a Huffman code is too long");
  const rest = (1 << log) - sum;
  if ((rest & (rest - 1)) !== 0) corrupt("the last Huffman weight");
  weights[n] = 32 - Math.clz32(rest);
  starts[weights[n]]++;
  if (starts[1] < 2) corrupt("a Huffman tree without two longest codes");
  let at = 0;
  for (let w = 1; w <= log; w++) {
    const count = starts[w];
    starts[w] = at;
    at += count << (w - 1);
  }
  const { entries } = table;
  table.log = log;
  for (let s = 0; s <= n; s++) {
    const w = weights[s];
    if (w === 0) continue;
    const from = starts[w];
    starts[w] = from + (1 << (w - 1));
    entries.fill(s | ((log + 1 - w) << 8), from, starts[w]);
  }
}

/** Decodes the stream `bytes[from..to)` to `out[at..end)`. It must end with its last bit. */
export function decodeStream(
  table: HuffmanTable,
  bytes: Uint8Array,
  view: DataView,
  from: number,
  to: number,
  out: Uint8Array,
  at: number,
  end: number,
): void {
  finishStream(table, view, from, bitLength(bytes, from, to), out, at, end);
}

/**
 * Decodes four streams, which begin at `starts[0]`, .. and end where the next one begins, to `size` bytes from
 * 0 on: a quarter each, rounded up. They take turns, since none of them waits for another. The four are written
 * out, so that nothing of them is in memory.
 */
export function decodeFourStreams(
  table: HuffmanTable,
  bytes: Uint8Array,
  view: DataView,
  starts: ArrayLike<number>,
  out: Uint8Array,
  size: number,
): void {
  const { log, entries } = table;
  const mask = (1 << log) - 1;
  const part = (size + 3) >> 2;
  const [from0, from1, from2, from3, to] = Array.from(starts);
  let left0 = bitLength(bytes, from0, from1);
  let left1 = bitLength(bytes, from1, from2);
  let left2 = bitLength(bytes, from2, from3);
  let left3 = bitLength(bytes, from3, to);
  const at1 = part;
  const at2 = 2 * part;
  const at3 = 3 * part;
  let o = 0;
  // A load has at least 25 bits that count: two codes. The last part is the shortest.
  for (const pairs = size - at3 - 1; o < pairs; o += 2) {
    if (((left0 - 25) | (left1 - 25) | (left2 - 25) | (left3 - 25)) < 0) break;
    let low = (left0 - 25) & ~7;
    let word = view.getInt32(from0 + (low >> 3), true);
    let entry = entries[(word >>> (left0 - low - log)) & mask];
    out[o] = entry;
    left0 -= entry >> 8;
    entry = entries[(word >>> (left0 - low - log)) & mask];
    out[o + 1] = entry;
    left0 -= entry >> 8;

    low = (left1 - 25) & ~7;
    word = view.getInt32(from1 + (low >> 3), true);
    entry = entries[(word >>> (left1 - low - log)) & mask];
    out[at1 + o] = entry;
    left1 -= entry >> 8;
    entry = entries[(word >>> (left1 - low - log)) & mask];
    out[at1 + o + 1] = entry;
    left1 -= entry >> 8;

    low = (left2 - 25) & ~7;
    word = view.getInt32(from2 + (low >> 3), true);
    entry = entries[(word >>> (left2 - low - log)) & mask];
    out[at2 + o] = entry;
    left2 -= entry >> 8;
    entry = entries[(word >>> (left2 - low - log)) & mask];
    out[at2 + o + 1] = entry;
    left2 -= entry >> 8;

    low = (left3 - 25) & ~7;
    word = view.getInt32(from3 + (low >> 3), true);
    entry = entries[(word >>> (left3 - low - log)) & mask];
    out[at3 + o] = entry;
    left3 -= entry >> 8;
    entry = entries[(word >>> (left3 - low - log)) & mask];
    out[at3 + o + 1] = entry;
    left3 -= entry >> 8;
  }
  const finish = (from: number, left: number, at: number, end: number) =>
    finishStream(table, view, from, left, out, Math.min(at, size) + o, Math.min(end, size));
  finish(from0, left0, 0, at1);
  finish(from1, left1, at1, at2);
  finish(from2, left2, at2, at3);
  finish(from3, left3, at3, size);
}

/** Decodes the last `left` bits of the stream that begins at `from` to `out[at..end)`. */
function finishStream(
  table: HuffmanTable,
  view: DataView,
  from: number,
  bits: number,
  out: Uint8Array,
  at: number,
  end: number,
): void {
  const { log, entries } = table;
  const mask = (1 << log) - 1;
  let left = bits;
  let o = at;
  for (const pairs = end - 1; o < pairs && left >= 25; o += 2) {
    const first = (left - 25) >> 3;
    const word = view.getInt32(from + first, true);
    let top = left - 8 * first;
    let entry = entries[(word >>> (top - log)) & mask];
    out[o] = entry;
    top -= entry >> 8;
    entry = entries[(word >>> (top - log)) & mask];
    out[o + 1] = entry;
    left = 8 * first + top - (entry >> 8);
  }
  for (; o < end; o++) {
    const low = left - log;
    const word = view.getInt32(from + (Math.max(low, 0) >> 3), true);
    const index = low >= 0 ? word >>> (low & 7) : word << -low;
    const entry = entries[index & mask];
    out[o] = entry;
    left -= entry >> 8;
    if (left < 0) corrupt("a Huffman stream ends early");
  }
  if (left !== 0) corrupt("a Huffman stream has bits left");
}
