/** Numbers in fewer bits, as the shader of `glsl.ts` reads them. */

const F32 = new Float32Array(1);
const BITS = new Uint32Array(F32.buffer);

/** Of numbers without their signs: the least normal binary16, the largest, and what rounds to 0. */
const LEAST_NORMAL = 0x38800000;
const LARGEST = 0x477fe000;
const NOTHING = 0x33000000;

/** The binary16 nearest to a number as binary32, ties to even; what is too large becomes the largest. */
export function half(value: number): number {
  F32[0] = value;
  const bits = BITS[0];
  const sign = (bits >>> 16) & 0x8000;
  const rest = bits & 0x7fffffff;
  if (rest <= NOTHING) return sign;
  if (rest >= LARGEST) return sign | 0x7bff;
  if (rest >= LEAST_NORMAL) return sign | (((rest + 0xfff + ((rest >>> 13) & 1)) >>> 13) - (112 << 10));
  // Below 2^-14: a multiple of 2^-24.
  const mantissa = (rest & 0x7fffff) | 0x800000;
  const shift = 126 - (rest >>> 23);
  return sign | ((mantissa + (1 << (shift - 1)) - 1 + ((mantissa >>> shift) & 1)) >>> shift);
}

/** The binary16 of integers in some unit: those of 16 bits stand in a table. */
export class Halves {
  private readonly table: Uint16Array;

  constructor(private readonly unit: number) {
    this.table = Uint16Array.from({ length: 65536 }, (_, i) => half((i - 32768) * unit));
  }

  of(integer: number): number {
    const i = integer + 32768;
    return i >>> 16 === 0 ? this.table[i] : half(integer * this.unit);
  }
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
  const length = Math.sqrt(w * w + x * x + y * y + z * z);
  let largest = 0;
  let most = length > 0 ? w : 1;
  let [a, b, c] = [x, y, z];
  if (Math.abs(x) > Math.abs(most)) [largest, most, a, b, c] = [1, x, w, y, z];
  if (Math.abs(y) > Math.abs(most)) [largest, most, a, b, c] = [2, y, w, x, z];
  if (Math.abs(z) > Math.abs(most)) [largest, most, a, b, c] = [3, z, w, x, y];
  const scale = ((most < 0 ? -1 : 1) * Math.SQRT2 * 32767) / (2 * (length > 0 ? length : 1));
  out[at] = (inSteps(a * scale) | (inSteps(b * scale) << 15) | (largest << 30)) >>> 0;
  out[at + 1] = inSteps(c * scale);
}

/** A part of a rotation, from -16383.5 to 16383.5, as one of 32,768 steps. */
function inSteps(part: number): number {
  return Math.min(32767, Math.max(0, Math.floor(part + 16384)));
}
