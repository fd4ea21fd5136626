/** Numbers in fewer bits, as the shader of `glsl.ts` reads them. */

const F32 = new Float32Array(1);
const BITS = new Uint32Array(F32.buffer);

/** The binary16 nearest to a number, ties to even; what is too large becomes the largest. */
export function half(value: number): number {
  F32[0] = Math.min(65504, Math.max(-65504, value));
  const bits = BITS[0];
  const sign = (bits >>> 16) & 0x8000;
  const exponent = (bits >>> 23) & 0xff;
  if (exponent < 113) {
    // Below 2^-14: a multiple of 2^-24.
    const n = Math.abs(F32[0]) * 2 ** 24;
    const floor = Math.floor(n);
    const up = n - floor > 0.5 || (n - floor === 0.5 && (floor & 1) === 1) ? 1 : 0;
    return sign | (floor + up);
  }
  const rounded = bits + 0xfff + ((bits >>> 13) & 1);
  return sign | (((rounded & 0x7fffffff) >>> 13) - (112 << 10));
}

export const MIN_LN_SCALE = -20;
export const LN_SCALE_STEPS = 2048;

/** A natural logarithm of a scale, in steps of 1/2048 from -20 to 12. */
export function lnScale(value: number): number {
  return Math.min(65535, Math.max(0, Math.round((value - MIN_LN_SCALE) * LN_SCALE_STEPS)));
}

/**
 * A rotation without its largest component, in 47 bits: two of which one it is, then three of 15 bits each.
 * The lower 32 bits go to `out[at]`, the rest to the lower half of `out[at + 1]`.
 */
export function packRotation(w: number, x: number, y: number, z: number, out: Uint32Array, at: number): void {
  const length = Math.hypot(w, x, y, z);
  const q = length > 0 ? [w / length, x / length, y / length, z / length] : [1, 0, 0, 0];
  let largest = 0;
  for (let i = 1; i < 4; i++) if (Math.abs(q[i]) > Math.abs(q[largest])) largest = i;
  const scale = ((q[largest] < 0 ? -1 : 1) * Math.SQRT2 * 32767) / 2;
  const parts: number[] = [];
  for (let i = 0; i < 4; i++) {
    if (i !== largest) parts.push(Math.min(32767, Math.max(0, Math.round(q[i] * scale + 16383.5))));
  }
  out[at] = (parts[0] | (parts[1] << 15) | (largest << 30)) >>> 0;
  out[at + 1] = parts[2];
}
