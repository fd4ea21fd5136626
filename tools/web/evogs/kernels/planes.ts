/** From planes to integers (spec 5.9, 7.1). A coding byte has `low` bits, `high` planes above, and `delta`. */

/** Whether all `n` bytes at `at` are below 2^bits. */
export function areBelow(at: usize, n: usize, bits: i32): bool {
  let many: u64 = 0;
  let i: usize = 0;
  for (; i + 8 <= n; i += 8) many |= load<u64>(at + i);
  for (; i < n; i++) many |= load<u8>(at + i);
  const above: u32 = 0x01010101 * (255 & (255 << bits));
  return ((<u32>many | <u32>(many >> 32)) & above) === 0;
}

/** The `n` stored integers of a list whose planes begin at `planes`. The coding byte is not 0. */
export function unpack(coding: i32, n: usize, planes: usize, out: usize): void {
  const low = coding & 15;
  const high = (coding >> 4) & 3;
  let above = planes;
  if (low === 1 || low === 2 || low === 4) {
    unpackBits(low, n, planes, out);
    above += (n * low + 7) >> 3;
  } else if (low > 0) {
    unpackBytes(n, planes, out);
    above += n;
  } else if (high > 0) {
    unpackBytes(n, planes, out);
    above += n;
    if (high === 2) addPlane(n, above, 8, out);
    return;
  }
  for (let k = 0; k < high; k++, above += n) addPlane(n, above, low + 8 * k, out);
}

/** Integers of 1, 2 or 4 bits. */
function unpackBits(low: i32, n: usize, plane: usize, out: usize): void {
  const mask: u32 = (1 << low) - 1;
  const step: usize = low;
  for (let i: usize = 0, bit: usize = 0; i < n; i++, bit += step) {
    store<u32>(out + (i << 2), (<u32>load<u8>(plane + (bit >> 3)) >> <u32>(bit & 7)) & mask);
  }
}

// Loops over 16 or 32 integers at a time write up to 31 too many: all arrays have room for them.

function unpackBytes(n: usize, plane: usize, out: usize): void {
  for (let i: usize = 0; i < n; i += 16) {
    const bytes = v128.load(plane + i);
    const first = i16x8.extend_low_i8x16_u(bytes);
    const last = i16x8.extend_high_i8x16_u(bytes);
    const to = out + (i << 2);
    v128.store(to, i32x4.extend_low_i16x8_u(first), 0);
    v128.store(to, i32x4.extend_high_i16x8_u(first), 16);
    v128.store(to, i32x4.extend_low_i16x8_u(last), 32);
    v128.store(to, i32x4.extend_high_i16x8_u(last), 48);
  }
}

/** Adds a plane of bytes that count from bit `shift` on. */
function addPlane(n: usize, plane: usize, shift: i32, out: usize): void {
  for (let i: usize = 0; i < n; i += 16) {
    const bytes = v128.load(plane + i);
    const first = i16x8.extend_low_i8x16_u(bytes);
    const last = i16x8.extend_high_i8x16_u(bytes);
    const to = out + (i << 2);
    addFour(to, i32x4.extend_low_i16x8_u(first), shift);
    addFour(to + 16, i32x4.extend_high_i16x8_u(first), shift);
    addFour(to + 32, i32x4.extend_low_i16x8_u(last), shift);
    addFour(to + 48, i32x4.extend_high_i16x8_u(last), shift);
  }
}

function addFour(to: usize, four: v128, shift: i32): void {
  v128.store(to, v128.or(v128.load(to), i32x4.shl(four, shift)));
}

/**
 * As `unpack`, of signed integers: 0, 1, 2, 3, 4 ... means 0, -1, 1, -2, 2 ... each times `factor`. The products
 * are within 32 bits if 2^23 * factor is, or if what is returned says so: no integer is further from 0, without
 * the factor.
 */
export function unpackSigned(coding: i32, n: usize, planes: usize, factor: i32, out: usize): u32 {
  const factors = i32x4.splat(factor);
  if (coding === 0x10 || coding === 0x50 || coding === 0x08 || coding === 0x48) {
    let all = i8x16.splat(0);
    let i: usize = 0;
    for (; i + 16 <= n; i += 16) {
      const bytes = v128.load(planes + i);
      all = v128.or(all, bytes);
      writeSigned(bytes, factors, out + (i << 2));
    }
    const rest = lowest(v128.load(planes + i), n - i);
    writeSigned(rest, factors, out + (i << 2));
    return furthest(v128.or(all, rest));
  }
  if (coding === 0x04 || coding === 0x44) {
    let all = i8x16.splat(0);
    for (let i: usize = 0; i < n; i += 32) {
      // Bits behind the last integer are 0.
      const pairs = lowest(v128.load(planes + (i >> 1)), (n - i + 1) >> 1);
      const low = v128.and(pairs, i8x16.splat(15));
      const high = i8x16.shr_u(pairs, 4);
      all = v128.or(all, v128.or(low, high));
      const to = out + (i << 2);
      writeSigned(i8x16.shuffle(low, high, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23), factors, to);
      writeSigned(
        i8x16.shuffle(low, high, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31),
        factors,
        to + 64,
      );
    }
    return furthest(all);
  }
  unpack(coding, n, planes, out);
  const ones = i32x4.splat(1);
  let all: u32 = 0;
  for (let i: usize = 0; i < n; i++) all |= load<u32>(out + (i << 2));
  for (let i: usize = 0; i < n; i += 4) {
    const to = out + (i << 2);
    const stored = v128.load(to);
    const sign = i32x4.neg(v128.and(stored, ones));
    v128.store(to, i32x4.mul(v128.xor(i32x4.shr_u(stored, 1), sign), factors));
  }
  return (all + 1) >> 1;
}

/** The first `n` bytes of 16, or all; 0 in place of the others. */
function lowest(bytes: v128, n: usize): v128 {
  const places = i8x16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  return v128.and(bytes, i8x16.lt_u(places, i8x16.splat(<i8>min(n, 16))));
}

/** Signed integers of 16 bytes. */
function writeSigned(bytes: v128, factors: v128, to: usize): void {
  const sign = i8x16.neg(v128.and(bytes, i8x16.splat(1)));
  const signed = v128.xor(i8x16.shr_u(bytes, 1), sign);
  const first = i16x8.extend_low_i8x16_s(signed);
  const last = i16x8.extend_high_i8x16_s(signed);
  v128.store(to, i32x4.mul(i32x4.extend_low_i16x8_s(first), factors), 0);
  v128.store(to, i32x4.mul(i32x4.extend_high_i16x8_s(first), factors), 16);
  v128.store(to, i32x4.mul(i32x4.extend_low_i16x8_s(last), factors), 32);
  v128.store(to, i32x4.mul(i32x4.extend_high_i16x8_s(last), factors), 48);
}

/** How far from 0 signed integers are at most whose bytes have these bits. */
function furthest(bytes: v128): u32 {
  const eight = i64x2.extract_lane(bytes, 0) | i64x2.extract_lane(bytes, 1);
  const four = <u32>eight | <u32>(eight >> 32);
  const two = four | (four >> 16);
  return (((two | (two >> 8)) & 255) + 1) >> 1;
}

/** Running sums. None is further from 0 than what is returned. */
export function undelta(values: usize, n: usize): u32 {
  let sum: i32 = 0;
  let furthest: u32 = 0;
  for (let i: usize = 0; i < n; i++) {
    sum += load<i32>(values + (i << 2));
    // Differences are within 2^28, so that no sum passes 2^28 unseen.
    furthest = max(furthest, <u32>(sum ^ (sum >> 31)));
    store<i32>(values + (i << 2), sum);
  }
  return furthest + 1;
}

/** R, G, B in place of Y, Co, Cg (YCoCg-R), each times `factor`. */
export function inverseYcocg(y: usize, co: usize, cg: usize, n: usize, factor: i32): void {
  const factors = i32x4.splat(factor);
  const bytes = n << 2;
  for (let i: usize = 0; i < bytes; i += 16) {
    const orange = v128.load(co + i);
    const green = v128.load(cg + i);
    const t = i32x4.sub(v128.load(y + i), i32x4.shr_s(green, 1));
    const b = i32x4.sub(t, i32x4.shr_s(orange, 1));
    v128.store(y + i, i32x4.mul(i32x4.add(b, orange), factors));
    v128.store(co + i, i32x4.mul(i32x4.add(green, t), factors));
    v128.store(cg + i, i32x4.mul(b, factors));
  }
}
