/** Sets of byte ranges. */

/** Bytes from `start` to `end` - 1. */
export interface ByteRange {
  start: number;
  end: number;
}

/** Ranges that neither overlap nor touch, in increasing order. */
export class Intervals {
  /** Bytes in the set. */
  total = 0;
  private ranges: ByteRange[] = [];

  add(start: number, end: number): void {
    if (end <= start) return;
    const from = this.firstEndingFrom(start);
    let to = from;
    const merged = { start, end };
    for (; to < this.ranges.length && this.ranges[to].start <= end; to++) {
      const { start: s, end: e } = this.ranges[to];
      merged.start = Math.min(merged.start, s);
      merged.end = Math.max(merged.end, e);
      this.total -= e - s;
    }
    this.ranges.splice(from, to - from, merged);
    this.total += merged.end - merged.start;
  }

  /** The parts of start .. end - 1 that are not in the set. */
  missing(start: number, end: number): ByteRange[] {
    const out: ByteRange[] = [];
    let at = start;
    for (let i = this.firstEndingFrom(start); i < this.ranges.length && this.ranges[i].start < end; i++) {
      if (this.ranges[i].start > at) out.push({ start: at, end: this.ranges[i].start });
      at = Math.max(at, this.ranges[i].end);
    }
    if (at < end) out.push({ start: at, end });
    return out;
  }

  has(start: number, end: number): boolean {
    const i = this.firstEndingFrom(end);
    return start >= end || (i < this.ranges.length && this.ranges[i].start <= start);
  }

  copy(): Intervals {
    const copy = new Intervals();
    copy.ranges = this.ranges.map((range) => ({ ...range }));
    copy.total = this.total;
    return copy;
  }

  /** The index of the first range that ends at `at` or later. */
  private firstEndingFrom(at: number): number {
    let low = 0;
    let high = this.ranges.length;
    while (low < high) {
      const middle = (low + high) >>> 1;
      if (this.ranges[middle].end < at) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}
