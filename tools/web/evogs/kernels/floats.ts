/** The float view (spec 7.6): binary32 of (O + X) * 2^-G. The sum and the product are exact in binary64. */

/** Values of `n` numbers. Up to 3 more are written. */
export function toFloats(numbers: usize, n: usize, origin: f64, unit: f64, out: usize): void {
  const origins = f64x2.splat(origin);
  const units = f64x2.splat(unit);
  const end = n << 2;
  for (let i: usize = 0; i < end; i += 16) {
    const four = v128.load(numbers + i);
    const low = f64x2.convert_low_i32x4_s(four);
    const high = f64x2.convert_low_i32x4_s(
      i8x16.shuffle(four, four, 8, 9, 10, 11, 12, 13, 14, 15, 8, 9, 10, 11, 12, 13, 14, 15),
    );
    const first = f32x4.demote_f64x2_zero(f64x2.mul(f64x2.add(low, origins), units));
    const last = f32x4.demote_f64x2_zero(f64x2.mul(f64x2.add(high, origins), units));
    v128.store(out + i, i64x2.shuffle(first, last, 0, 2));
  }
}

/** The 4 bytes at each of `n` places of a table. */
export function gather(table: usize, places: usize, n: usize, out: usize): void {
  for (let i: usize = 0; i < n; i++) {
    store<i32>(out + (i << 2), load<i32>(table + (load<i32>(places + (i << 2)) << 2)));
  }
}

/**
 * As `gather`, of four tables at once, whose elements stand side by side: to `out`, and to `stride` bytes behind,
 * three times. Up to 3 more of each are written.
 */
export function gatherFour(tables: usize, places: usize, n: usize, out: usize, stride: usize): void {
  for (let i: usize = 0; i < n << 2; i += 16) {
    const a = v128.load(tables + (load<i32>(places + i, 0) << 4));
    const b = v128.load(tables + (load<i32>(places + i, 4) << 4));
    const c = v128.load(tables + (load<i32>(places + i, 8) << 4));
    const d = v128.load(tables + (load<i32>(places + i, 12) << 4));
    const ab = i32x4.shuffle(a, b, 0, 4, 1, 5);
    const cd = i32x4.shuffle(c, d, 0, 4, 1, 5);
    const abHigh = i32x4.shuffle(a, b, 2, 6, 3, 7);
    const cdHigh = i32x4.shuffle(c, d, 2, 6, 3, 7);
    const to = out + i;
    v128.store(to, i64x2.shuffle(ab, cd, 0, 2));
    v128.store(to + stride, i64x2.shuffle(ab, cd, 1, 3));
    v128.store(to + 2 * stride, i64x2.shuffle(abHigh, cdHigh, 0, 2));
    v128.store(to + 3 * stride, i64x2.shuffle(abHigh, cdHigh, 1, 3));
  }
}

/** Puts four tables of `n` elements side by side, for `gatherFour`; `stride` bytes lie between two. Up to 3 more. */
export function mixFour(tables: usize, stride: usize, n: usize, out: usize): void {
  for (let i: usize = 0; i < n << 2; i += 16) {
    const from = tables + i;
    const a = v128.load(from);
    const b = v128.load(from + stride);
    const c = v128.load(from + 2 * stride);
    const d = v128.load(from + 3 * stride);
    const ab = i32x4.shuffle(a, b, 0, 4, 1, 5);
    const cd = i32x4.shuffle(c, d, 0, 4, 1, 5);
    const abHigh = i32x4.shuffle(a, b, 2, 6, 3, 7);
    const cdHigh = i32x4.shuffle(c, d, 2, 6, 3, 7);
    const to = out + (i << 2);
    v128.store(to, i64x2.shuffle(ab, cd, 0, 2), 0);
    v128.store(to, i64x2.shuffle(ab, cd, 1, 3), 16);
    v128.store(to, i64x2.shuffle(abHigh, cdHigh, 0, 2), 32);
    v128.store(to, i64x2.shuffle(abHigh, cdHigh, 1, 3), 48);
  }
}
