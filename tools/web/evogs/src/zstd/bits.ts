/** Bits of Zstandard streams that are read backwards (RFC 8878, 4.1). */

import { corrupt } from "./error.js";

/** Bytes behind a stream that a reader may touch: it loads four at a time. */
export const PADDING = 8;

/** Number of bits of the stream `bytes[from..to)`, without the end mark. */
export function bitLength(bytes: Uint8Array, from: number, to: number): number {
  if (to <= from) corrupt("an empty bit stream");
  const last = bytes[to - 1];
  if (last === 0) corrupt("a bit stream without its end mark");
  return 8 * (to - from) - Math.clz32(last) + 23;
}

/** Reads bits from the last one down. `left` is the number of those not read. */
export class BackwardBits {
  left: number;

  constructor(
    readonly view: DataView,
    bytes: Uint8Array,
    readonly from: number,
    to: number,
  ) {
    this.left = bitLength(bytes, from, to);
  }

  /** The next `n` bits, 0 to 24. A stream that ends before is corrupt. */
  read(n: number): number {
    const left = this.left - n;
    if (left < 0) corrupt("a bit stream ends early");
    this.left = left;
    return (this.view.getInt32(this.from + (left >> 3), true) >>> (left & 7)) & ((1 << n) - 1);
  }

  /** As `read`, but bits that are missing are 0 and make `left` negative. Only the last read may be such. */
  readPast(n: number): number {
    if (this.left >= n) return this.read(n);
    const missing = n - this.left;
    const value = this.read(this.left) << missing;
    this.left = -missing;
    return value;
  }
}
