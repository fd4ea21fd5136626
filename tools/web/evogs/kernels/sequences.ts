/** The sequences section of a compressed block, and its execution (RFC 8878, 3.1.1.3.2, 3.1.1.4, 3.1.1.5). */

import { bitLength, bitsAbove, lowBits } from "./bits";
import { readTable, setCounts, tableLog } from "./fse";

const LL = 0;
const OF = 1;
const ML = 2;
/** Extra bits of each code. */
const LL_EXTRA: usize = memory.data<u8>([
  0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
  16,
]);
const ML_EXTRA: usize = memory.data<u8>([
  0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2,
  3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,
]);
/** Counts of the predefined tables. */
const LL_COUNTS: usize = memory.data<i16>([
  4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1, -1, -1, -1,
]);
const ML_COUNTS: usize = memory.data<i16>([
  1, 4, 3, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
  1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -1,
]);
const OF_COUNTS: usize = memory.data<i16>([
  1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1,
]);
const MAX_OF_PREDEFINED: u32 = 28;

const MAX_LOG = 9;
const MAX_LL: u32 = 35;
const MAX_OF: u32 = 31;
const MAX_ML: u32 = 52;
/** An offset of this many bits is above any frame: 16 MiB (R-5.10-4). */
const TOO_MANY_BITS = 25;

/** What each code of LL, OF and ML stands for: the least number, and extra bits << 32. 64 codes of each kind. */
const CODES: usize = memory.data(3 * 64 * 8, 16);
/** An FSE table as it is read. */
const ENTRIES: usize = memory.data(4 << MAX_LOG, 16);
/**
 * For LL, OF and ML the table of the block, and the log of each. Entries have 8 bytes: the number that a code
 * stands for, its extra bits << 32, bits of the next state << 40, base of it << 48.
 */
const TABLES: usize = memory.data(3 * (8 << MAX_LOG), 16);
const LOGS: usize = memory.data(3 * 4, 16);

let hasCodes: bool = false;
let hasTables: bool = false;
let rep1: i32 = 1;
let rep2: i32 = 4;
let rep3: i32 = 8;

/** Where the literals of a block are taken, and how many were. */
let literal: usize = 0;

/** A new frame begins. */
export function resetSequences(): void {
  if (!hasCodes) makeCodes();
  hasTables = false;
  rep1 = 1;
  rep2 = 4;
  rep3 = 8;
}

/**
 * Reads the section `from..to` and writes the block to `out..end`, or less. Matches may reach back to `start`.
 * Literals are at `literals..literalsEnd`. Returns where the block ends; 0 if it is corrupt.
 * It writes up to 15 bytes behind that.
 */
export function runSequences(
  from: usize,
  to: usize,
  literals: usize,
  literalsEnd: usize,
  start: usize,
  out: usize,
  end: usize,
): usize {
  let p = from;
  let at = out;
  if (p >= to) return 0;
  let count: i32 = load<u8>(p++);
  if (count === 255) {
    if (p + 2 > to) return 0;
    count = <i32>load<u16>(p) + 0x7f00;
    p += 2;
  } else if (count > 127) {
    if (p >= to) return 0;
    count = ((count - 128) << 8) + load<u8>(p++);
  }
  literal = literals;
  if (count === 0) {
    // R-5.10-11: a 0 in two bytes is as good as one in a byte.
    if (p !== to) return 0;
  } else {
    if (p >= to) return 0;
    p = readTables(p, to);
    if (p === 0) return 0;
    at = execute(p, bitLength(p, to), count, literalsEnd, start, at, end);
    if (at === 0) return 0;
  }
  const rest = literalsEnd - literal;
  if (rest > end - at) return 0;
  memory.copy(at, literal, rest);
  return at + rest;
}

/** Reads the modes and tables of a block. Returns where they end; 0 if they are corrupt. */
function readTables(from: usize, to: usize): usize {
  const modes: i32 = load<u8>(from);
  if (modes & 3) return 0;
  let p = from + 1;
  p = readOne(LL, modes >> 6, p, to, MAX_LOG, MAX_LL);
  if (p !== 0) p = readOne(OF, (modes >> 4) & 3, p, to, 8, MAX_OF);
  if (p !== 0) p = readOne(ML, (modes >> 2) & 3, p, to, MAX_LOG, MAX_ML);
  hasTables = true;
  return p;
}

function readOne(kind: i32, mode: i32, from: usize, to: usize, maxLog: i32, maxSymbol: u32): usize {
  let p = from;
  let log = 0;
  if (mode === 3) return hasTables ? p : 0;
  if (mode === 0) {
    log = kind === OF ? 5 : 6;
    const counts = kind === LL ? LL_COUNTS : kind === OF ? OF_COUNTS : ML_COUNTS;
    setCounts(ENTRIES, log, counts, 1 + (kind === OF ? MAX_OF_PREDEFINED : maxSymbol));
  } else if (mode === 1) {
    if (p >= to || load<u8>(p) > <u8>maxSymbol) return 0;
    store<u32>(ENTRIES, load<u8>(p++));
  } else {
    p = readTable(p, to, ENTRIES, maxLog, maxSymbol);
    if (p === 0) return 0;
    log = tableLog;
  }
  store<i32>(LOGS + 4 * kind, log);
  const table = TABLES + kind * (8 << MAX_LOG);
  const codes = CODES + kind * 512;
  for (let i = 0; i < 1 << log; i++) {
    const entry: u64 = load<u32>(ENTRIES + 4 * i);
    const code = load<u64>(codes + 8 * <usize>(entry & 255));
    store<u64>(table + 8 * i, code | (((entry >> 8) & 255) << 40) | ((entry >> 16) << 48));
  }
  return p;
}

function makeCodes(): void {
  let literals: u64 = 0;
  let match: u64 = 3;
  for (let code: usize = 0; code <= MAX_ML; code++) {
    const place = CODES + 8 * code;
    if (code <= MAX_LL) {
      const extra: u64 = load<u8>(LL_EXTRA + code);
      store<u64>(place, literals | (extra << 32));
      literals += (<u64>1) << extra;
    }
    if (code <= MAX_OF) store<u64>(place, ((<u64>1) << code) | ((<u64>code) << 32), 512);
    const extra: u64 = load<u8>(ML_EXTRA + code);
    store<u64>(place, match | (extra << 32), 1024);
    match += (<u64>1) << extra;
  }
  hasCodes = true;
}

/** Returns where the last match ends; 0 if the sequences are corrupt. */
function execute(
  first: usize,
  length: i32,
  count: i32,
  literalsEnd: usize,
  start: usize,
  from: usize,
  end: usize,
): usize {
  const llTable = TABLES;
  const ofTable = TABLES + (8 << MAX_LOG);
  const mlTable = TABLES + 2 * (8 << MAX_LOG);
  const llLog = load<i32>(LOGS);
  const ofLog = load<i32>(LOGS, 4);
  const mlLog = load<i32>(LOGS, 8);
  let left = length - llLog - ofLog - mlLog;
  if (left < 0) return 0;
  let bits = bitsAbove(first, left);
  let mlEntry = load<u64>(mlTable + 8 * lowBits(bits, mlLog));
  let ofEntry = load<u64>(ofTable + 8 * lowBits(bits >> mlLog, ofLog));
  let llEntry = load<u64>(llTable + 8 * lowBits(bits >> (mlLog + ofLog), llLog));
  let at = from;
  let source = literal;
  for (let i = count; ; ) {
    const ofBits = <i32>((ofEntry >> 32) & 255);
    const mlBits = <i32>((mlEntry >> 32) & 255);
    const llBits = <i32>((llEntry >> 32) & 255);
    if (ofBits >= TOO_MANY_BITS) return 0;
    left -= ofBits + mlBits + llBits;
    if (left < 0) return 0;
    bits = bitsAbove(first, left);
    const literalLength: usize = <u32>llEntry + lowBits(bits, llBits);
    bits >>= llBits;
    const matchLength: usize = <u32>mlEntry + lowBits(bits, mlBits);
    bits >>= mlBits;
    const ofValue = <i32>ofEntry + lowBits(bits, ofBits);

    // Repeated offsets (R-5.10-7).
    let offset = ofValue - 3;
    if (ofValue > 3) {
      rep3 = rep2;
      rep2 = rep1;
      rep1 = offset;
    } else {
      const index = literalLength === 0 ? ofValue + 1 : ofValue;
      offset = index === 1 ? rep1 : index === 2 ? rep2 : index === 3 ? rep3 : rep1 - 1;
      if (index > 2) rep3 = rep2;
      if (index > 1) rep2 = rep1;
      rep1 = offset;
    }

    if (literalLength > literalsEnd - source || literalLength + matchLength > end - at) return 0;
    copyFar(source, at, literalLength);
    source += literalLength;
    at += literalLength;
    if (offset === 0 || <usize>offset > at - start) return 0;
    copyMatch(at, offset, matchLength);
    at += matchLength;

    if (--i === 0) break;
    const llNext = <i32>((llEntry >> 40) & 255);
    const mlNext = <i32>((mlEntry >> 40) & 255);
    const ofNext = <i32>((ofEntry >> 40) & 255);
    left -= llNext + mlNext + ofNext;
    if (left < 0) return 0;
    bits = bitsAbove(first, left);
    ofEntry = load<u64>(ofTable + 8 * (<i32>(ofEntry >> 48) + lowBits(bits, ofNext)));
    bits >>= ofNext;
    mlEntry = load<u64>(mlTable + 8 * (<i32>(mlEntry >> 48) + lowBits(bits, mlNext)));
    bits >>= mlNext;
    llEntry = load<u64>(llTable + 8 * (<i32>(llEntry >> 48) + lowBits(bits, llNext)));
  }
  literal = source;
  return left === 0 ? at : 0;
}

/** Copies 16 bytes at a time, up to 15 too many. `to` is at least 16 bytes behind `from`, or elsewhere. */
function copyFar(from: usize, to: usize, n: usize): void {
  for (let i: usize = 0; i < n; i += 16) v128.store(to + i, v128.load(from + i));
}

/** A match may overlap what it writes. */
function copyMatch(at: usize, offset: usize, n: usize): void {
  if (offset >= 16) {
    copyFar(at - offset, at, n);
    return;
  }
  const near = min(n, 16);
  for (let i: usize = 0; i < near; i++) store<u8>(at + i, load<u8>(at + i - offset));
  if (n <= 16) return;
  // What is there repeats itself: the same bytes stand a multiple of the offset before.
  const far = offset * ((offset + 15) / offset);
  copyFar(at + 16 - far, at + 16, n - 16);
}
