/** The blocks of one frame (RFC 8878, 3.1.1.2), and their literals (3.1.1.3.1). */

import { decodeFourStreams, decodeStream, readTree } from "./huffman";
import { resetSequences, runSequences } from "./sequences";

/** A block regenerates at most this. */
const MAX_BLOCK: usize = 128 * 1024;
const MIN_FOR_FOUR_STREAMS: usize = 6;

const LITERALS: usize = memory.data(128 * 1024 + 16, 16);
let literalsEnd: usize = 0;
let hasTree: bool = false;

/**
 * Decompresses the blocks `from..to`, whose headers were checked (frames.ts), to the `size` bytes at `out`.
 * False if they are corrupt. It looks at 8 bytes behind `to`, and writes up to 15 behind the end.
 */
export function decompress(from: usize, to: usize, out: usize, size: usize): bool {
  hasTree = false;
  resetSequences();
  const blockMaximum = min(MAX_BLOCK, size);
  const end = out + size;
  let at = out;
  for (let p = from; p < to; ) {
    const head = load<u32>(p) & 0xffffff;
    const type = (head >> 1) & 3;
    const blockSize: usize = head >> 3;
    p += 3;
    if (type === 2) {
      const next = p + blockSize;
      const sequencesAt = readLiterals(p, next, blockMaximum);
      if (sequencesAt === 0) return false;
      at = runSequences(sequencesAt, next, LITERALS, literalsEnd, out, at, at + min(blockMaximum, end - at));
      if (at === 0) return false;
      p = next;
      continue;
    }
    if (blockSize > end - at) return false;
    if (type === 0) memory.copy(at, p, blockSize);
    else memory.fill(at, load<u8>(p), blockSize);
    at += blockSize;
    p += type === 0 ? blockSize : 1;
  }
  return at === end;
}

/** Reads the literals section at the beginning of `from..to`. Returns where it ends; 0 if it is corrupt. */
function readLiterals(from: usize, to: usize, blockMaximum: usize): usize {
  const head = load<u64>(from);
  const type = <i32>head & 3;
  const format = (<i32>head >> 2) & 3;
  if (type < 2) return readPlain(from, to, blockMaximum, type === 1, format);
  const headerSize = format < 2 ? 3 : format + 2;
  const width = format < 2 ? 10 : 4 * format + 6;
  let at = from + headerSize;
  if (at > to) return 0;
  const mask: u64 = (1 << width) - 1;
  const size = <usize>((head >> 4) & mask);
  const compressed = <usize>((head >> (4 + width)) & mask);
  if (size > blockMaximum) return 0;
  if (format > 0 && size < MIN_FOR_FOUR_STREAMS) return 0;
  const end = at + compressed;
  if (end > to) return 0;
  if (type === 2) {
    at = readTree(at, end);
    if (at === 0) return 0;
    hasTree = true;
  } else if (!hasTree) {
    return 0;
  }
  literalsEnd = LITERALS + size;
  const isGood = format === 0 ? decodeStream(at, end, LITERALS, literalsEnd) : decodeFour(at, end, size);
  return isGood ? end : 0;
}

function readPlain(from: usize, to: usize, blockMaximum: usize, isRun: bool, format: i32): usize {
  const headerSize = format === 1 ? 2 : format === 3 ? 3 : 1;
  const at = from + headerSize;
  if (at > to) return 0;
  const head: usize = load<u32>(from) & 0xffffff;
  const size = headerSize === 1 ? (head & 0xff) >> 3 : headerSize === 2 ? (head & 0xffff) >> 4 : head >> 4;
  const stored: usize = isRun ? 1 : size;
  if (size > blockMaximum || at + stored > to) return 0;
  literalsEnd = LITERALS + size;
  if (isRun) memory.fill(LITERALS, load<u8>(at), size);
  else memory.copy(LITERALS, at, size);
  return at + stored;
}

function decodeFour(from: usize, to: usize, size: usize): bool {
  const first = from + 6;
  if (first > to) return false;
  const second = first + load<u16>(from);
  const third = second + load<u16>(from, 2);
  const fourth = third + load<u16>(from, 4);
  return fourth <= to && decodeFourStreams(first, second, third, fourth, to, LITERALS, size);
}
