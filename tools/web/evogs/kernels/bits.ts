/** Bits of Zstandard streams that are read backwards (RFC 8878, 4.1). A stream may lie below 512 MiB. */

/** Number of bits of the stream `from..to` without the end mark; -1 if it has none. */
export function bitLength(from: usize, to: usize): i32 {
  if (to <= from) return -1;
  const last: i32 = load<u8>(to - 1);
  return last === 0 ? -1 : 8 * <i32>(to - from) - clz(last) + 23;
}

/** The 57 bits and more that stand above bit `at` of a stream. */
export function bitsAbove(from: usize, at: i32): u64 {
  return load<u64>(from + (at >> 3)) >> (at & 7);
}

/** The `n` lowest bits, of at most 63. */
export function lowBits(bits: u64, n: i32): i32 {
  return <i32>(bits & (((<u64>1) << n) - 1));
}
