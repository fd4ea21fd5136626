/** Which slots changed since someone asked: a bit for each slot. */

/** Slots from `start` on, `count` of them. */
export interface SlotRange {
  start: number;
  count: number;
}

const NO_BITS = new Uint32Array(0);

export class DirtySlots {
  private bits = NO_BITS;
  private end = 0;

  /** Marks the slots start .. end - 1. */
  markRange(start: number, end: number): void {
    this.reserve(end);
    const { bits } = this;
    for (let s = start; s < end; ) {
      if ((s & 31) === 0 && s + 32 <= end) {
        bits[s >>> 5] = 0xffffffff;
        s += 32;
      } else {
        bits[s >>> 5] |= 1 << (s & 31);
        s++;
      }
    }
  }

  /** Marks the slots of a step. They are increasing. */
  mark(slots: Int32Array): void {
    const n = slots.length;
    if (n === 0) return;
    this.reserve(slots[n - 1] + 1);
    const { bits } = this;
    for (let i = 0; i < n; i++) bits[slots[i] >>> 5] |= 1 << (slots[i] & 31);
  }

  /** The ranges of marked slots, and forgets them. Gaps of up to `maxGap` slots are taken with them. */
  take(maxGap: number): SlotRange[] {
    const ranges: SlotRange[] = [];
    const { bits, end } = this;
    let open: SlotRange | null = null;
    for (let s = 0; s < end; s++) {
      const word = bits[s >>> 5];
      if ((s & 31) === 0 && word === 0) {
        s += 31;
        continue;
      }
      if (((word >>> (s & 31)) & 1) === 0) continue;
      if (open !== null && s - (open.start + open.count) <= maxGap) open.count = s + 1 - open.start;
      else {
        open = { start: s, count: 1 };
        ranges.push(open);
      }
    }
    bits.fill(0);
    this.end = 0;
    return ranges;
  }

  private reserve(end: number): void {
    this.end = Math.max(this.end, end);
    const words = (end + 31) >>> 5;
    if (words <= this.bits.length) return;
    const wider = new Uint32Array(Math.max(words, 2 * this.bits.length));
    wider.set(this.bits);
    this.bits = wider;
  }
}
