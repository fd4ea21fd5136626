/** Arrays that packets use one after the other. They grow, and hold nothing between two packets. */

export class Workspace {
  private planeBytes = new Uint8Array(0);
  private readonly arrays: Int32Array[] = [];

  /** Bytes for the planes of a packet. */
  planes(size: number): Uint8Array {
    if (this.planeBytes.length < size) this.planeBytes = new Uint8Array(size);
    return this.planeBytes;
  }

  /** Array number `i`, with room for `n` integers. What it holds is not defined. */
  integers(i: number, n: number): Int32Array {
    const length = this.arrays[i]?.length ?? -1;
    // A bit more than is asked for, so that arrays that grow by little are not made anew each time.
    if (length < n) this.arrays[i] = new Int32Array(Math.max(n, Math.floor(1.25 * length)));
    return this.arrays[i];
  }
}

/** Who uses which array. Users that are at work at the same time have different ones. */
export const TRIPLE = 0; // and 1, 2
export const PSI_SLOTS = 3;
export const SPLITS = 4;
export const DROPS = 5;
export const PLAIN = 6;
export const SIBLINGS = 7;
export const PLACES = 8;
export const PARENTS = 9;
