/** Integers of some channels, for a growing number of slots: a structure of arrays in one array. */

/** Shared by all that have no slots yet: there may be many small tiles. */
export const NO_INTEGERS = new Int32Array(0);
export const NO_BYTES = new Uint8Array(0);

export class ChannelBlock {
  /** Number s of channel k stands at k * capacity + s. */
  data = NO_INTEGERS;
  capacity = 0;
  /** Slots so far: those after the last step that was applied. */
  count = 0;

  constructor(readonly nChannels: number) {}

  /** The numbers of channel `k` of the block, without a copy. They are valid until the next step. */
  channel(k: number): Int32Array {
    return this.data.subarray(k * this.capacity, k * this.capacity + this.count);
  }

  /** As `channel`, with the room for slots to come. */
  room(k: number): Int32Array {
    return this.data.subarray(k * this.capacity, (k + 1) * this.capacity);
  }

  /** Takes all numbers of `n` slots, and no more. */
  take(data: Int32Array, n: number): void {
    this.data = data;
    this.capacity = n;
    this.count = n;
  }

  /** Makes room for `n` slots. `most` is what the cut will need: all of it is taken at once if `atOnce`. */
  reserve(n: number, most: number, atOnce: boolean): void {
    if (n <= this.capacity) return;
    const capacity = atOnce ? most : Math.min(most, Math.max(n, 2 * this.capacity));
    const data = new Int32Array(this.nChannels * capacity);
    for (let k = 0; k < this.nChannels; k++) data.set(this.channel(k), k * capacity);
    this.data = data;
    this.capacity = capacity;
  }
}

/** As ChannelBlock.reserve, for one array. */
export function grown<T extends Int32Array | Uint8Array>(array: T, n: number, most: number, atOnce: boolean): T {
  if (n <= array.length) return array;
  const length = atOnce ? most : Math.min(most, Math.max(n, 2 * array.length));
  const wider = new (array.constructor as new (length: number) => T)(length);
  wider.set(array);
  return wider;
}
