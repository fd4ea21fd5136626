/** From planes to integers (spec 5.9, 7.1). */

const MAX_SUM = 1 << 28;

/** Bits of the plane of low bits, and the number of planes above it, of a coding byte. */
export const lowOf = (coding: number): number => coding & 15;
export const highOf = (coding: number): number => (coding >> 4) & 3;
export const hasDelta = (coding: number): boolean => (coding & 0x40) !== 0;

/** Whether the low bits share bytes. Otherwise each integer has a byte. */
const isPacked = (low: number): boolean => low === 1 || low === 2 || low === 4;

/** Bytes of the plane of low bits of `n` integers. */
export function lowPlaneSize(coding: number, n: number): number {
  const low = lowOf(coding);
  if (low === 0) return 0;
  return isPacked(low) ? Math.ceil((n * low) / 8) : n;
}

/** Whether no bit of the plane of low bits, which begins at `at`, belongs to no integer (R-5.9-9). */
export function isLowPlaneClean(coding: number, n: number, planes: Uint8Array, at: number): boolean {
  const low = lowOf(coding);
  if (low === 0 || low === 8) return true;
  if (isPacked(low)) {
    const used = (n * low) & 7;
    return used === 0 || planes[at + lowPlaneSize(coding, n) - 1] >> used === 0;
  }
  let all = 0;
  const plane = planes.subarray(at, at + n);
  for (let i = 0; i < n; i++) all |= plane[i];
  return all >> low === 0;
}

/** The `n` stored integers of a list whose planes begin at `at`. The coding byte is not 0. */
export function unpack(coding: number, n: number, planes: Uint8Array, at: number, out: Int32Array): void {
  const low = lowOf(coding);
  let from = at;
  if (isPacked(low)) unpackBits(low, n, planes.subarray(at), out);
  else if (low > 0) unpackBytes(planes.subarray(at, at + n), out);
  from += lowPlaneSize(coding, n);
  for (let k = 0; k < highOf(coding); k++, from += n) {
    const shift = low + 8 * k;
    const plane = planes.subarray(from, from + n);
    if (shift === 0) unpackBytes(plane, out);
    else for (let i = 0; i < n; i++) out[i] |= plane[i] << shift;
  }
}

/** As `unpack`, of signed integers: 0, 1, 2, 3, 4 ... means 0, -1, 1, -2, 2 ... each times `factor`. */
export function unpackSigned(
  coding: number,
  n: number,
  planes: Uint8Array,
  at: number,
  factor: number,
  out: Int32Array,
): void {
  const isByte = lowOf(coding) === 0 ? highOf(coding) === 1 : highOf(coding) === 0 && !isPacked(lowOf(coding));
  if (isByte) {
    const plane = planes.subarray(at, at + n);
    for (let i = 0; i < n; i++) out[i] = Math.imul((plane[i] >> 1) ^ -(plane[i] & 1), factor);
    return;
  }
  unpack(coding, n, planes, at, out);
  if (factor === 1) unzigzag(out, n);
  else for (let i = 0; i < n; i++) out[i] = Math.imul((out[i] >> 1) ^ -(out[i] & 1), factor);
}

function unpackBytes(plane: Uint8Array, out: Int32Array): void {
  for (let i = 0; i < plane.length; i++) out[i] = plane[i];
}

function unpackBits(low: number, n: number, plane: Uint8Array, out: Int32Array): void {
  const mask = (1 << low) - 1;
  const perByte = 8 / low;
  let i = 0;
  for (let p = 0; i < n; p++) {
    const end = Math.min(i + perByte, n);
    for (let byte = plane[p]; i < end; i++, byte >>= low) out[i] = byte & mask;
  }
}

/** 0, 1, 2, 3, 4 ... means 0, -1, 1, -2, 2 ... The integers are below 2^24. */
export function unzigzag(values: Int32Array, n: number): void {
  for (let i = 0; i < n; i++) values[i] = (values[i] >> 1) ^ -(values[i] & 1);
}

/** Running sums. False if one leaves +-2^28 (R-7.1-1). */
export function undelta(values: Int32Array, n: number): boolean {
  let sum = 0;
  for (let i = 0; i < n; i++) {
    sum += values[i];
    if (sum > MAX_SUM || sum < -MAX_SUM) return false;
    values[i] = sum;
  }
  return true;
}

/** R, G, B in place of Y, Co, Cg (YCoCg-R). Integers are within 2^28, so results are within 3 * 2^28. */
export function inverseYcocg(y: Int32Array, co: Int32Array, cg: Int32Array, n: number): void {
  for (let i = 0; i < n; i++) {
    const t = y[i] - (cg[i] >> 1);
    const g = cg[i] + t;
    const b = t - (co[i] >> 1);
    y[i] = b + co[i];
    co[i] = g;
    cg[i] = b;
  }
}
