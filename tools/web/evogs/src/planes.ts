/** From planes to integers (spec 5.9, 7.1). */

const MAX_SUM = 1 << 28;

/** Bits of the plane of low bits, and the number of planes above it, of a coding byte. */
export const lowOf = (coding: number): number => coding & 15;
export const highOf = (coding: number): number => (coding >> 4) & 3;
export const hasDelta = (coding: number): boolean => (coding & 0x40) !== 0;

/** Whether the low bits share bytes. Otherwise each integer has a byte. */
export const isPacked = (low: number): boolean => low === 1 || low === 2 || low === 4;

/** Whether the integers of a list have a plane of a byte each, and no other. */
export function isPlaneOfBytes(coding: number): boolean {
  const low = lowOf(coding);
  return low === 0 ? highOf(coding) === 1 : highOf(coding) === 0 && !isPacked(low);
}

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
  const high = highOf(coding);
  const above = at + lowPlaneSize(coding, n);
  if (low === 0 && high === 2) unpackPairs(planes, at, at + n, 8, n, out);
  else if (isPlaneOfBytes(coding)) unpackBytes(planes.subarray(at, at + n), out);
  else if (!isPacked(low) && high === 1) unpackPairs(planes, at, above, low, n, out);
  else {
    if (isPacked(low)) unpackBits(low, n, planes.subarray(at), out);
    else unpackBytes(planes.subarray(at, at + n), out);
    for (let k = 0; k < high; k++) addPlane(planes, above + k * n, low + 8 * k, n, out);
  }
}

/**
 * As `unpack`, of signed integers: 0, 1, 2, 3, 4 ... means 0, -1, 1, -2, 2 ... each times `factor`.
 * The kinds of lists that most integers are in have a loop of their own, since each pass costs as much again.
 */
export function unpackSigned(
  coding: number,
  n: number,
  planes: Uint8Array,
  at: number,
  factor: number,
  out: Int32Array,
): void {
  if (isPlaneOfBytes(coding)) {
    const plane = planes.subarray(at, at + n);
    for (let i = 0; i < n; i++) out[i] = Math.imul((plane[i] >> 1) ^ -(plane[i] & 1), factor);
  } else if (lowOf(coding) === 4 && highOf(coding) === 0) unpackSignedHalves(planes.subarray(at), n, factor, out);
  else {
    unpack(coding, n, planes, at, out);
    for (let i = 0; i < n; i++) out[i] = Math.imul((out[i] >> 1) ^ -(out[i] & 1), factor);
  }
}

/** Signed integers of 4 bits. */
function unpackSignedHalves(plane: Uint8Array, n: number, factor: number, out: Int32Array): void {
  const pairs = n & ~1;
  for (let i = 0, p = 0; i < pairs; i += 2, p++) {
    const byte = plane[p];
    out[i] = Math.imul(((byte >> 1) & 7) ^ -(byte & 1), factor);
    out[i + 1] = Math.imul((byte >> 5) ^ -((byte >> 4) & 1), factor);
  }
  if (pairs < n) out[pairs] = Math.imul(((plane[pairs >> 1] >> 1) & 7) ^ -(plane[pairs >> 1] & 1), factor);
}

/** Integers of a plane at `at` and one at `above`, whose bytes count from bit `shift` on. */
function unpackPairs(
  planes: Uint8Array,
  at: number,
  above: number,
  shift: number,
  n: number,
  out: Int32Array,
): void {
  for (let i = 0; i < n; i++) out[i] = planes[at + i] | (planes[above + i] << shift);
}

function addPlane(planes: Uint8Array, at: number, shift: number, n: number, out: Int32Array): void {
  for (let i = 0; i < n; i++) out[i] |= planes[at + i] << shift;
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
  // Negative once a sum was out of range.
  let margin = 0;
  for (let i = 0; i < n; i++) {
    sum = (sum + values[i]) | 0;
    margin |= (MAX_SUM - sum) | (MAX_SUM + sum);
    values[i] = sum;
  }
  return margin >= 0;
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
