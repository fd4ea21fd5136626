/** Bytes of a region that come from any places, in any order, in pieces of any size (spec 6.4). */

const PAGE = 1024;

interface Page {
  bytes: Uint8Array;
  /** A bit for each byte that came. */
  came: Uint32Array;
}

/**
 * A region in which bytes come and stay. Memory is in proportion to the bytes that came,
 * and to the number of pieces: pages without a byte do not exist.
 */
export class RangeBuffer {
  /** Bytes that came. */
  filled = 0;
  private readonly pages = new Map<number, Page>();
  private readonly pageSize: number;

  constructor(readonly size: number) {
    this.pageSize = Math.min(PAGE, size);
  }

  /** Takes bytes at an offset in the region. Bytes that came before are not compared. */
  put(offset: number, bytes: Uint8Array): void {
    const { pageSize } = this;
    for (let at = 0; at < bytes.length; ) {
      const number = Math.floor((offset + at) / pageSize);
      const from = offset + at - number * pageSize;
      const n = Math.min(pageSize - from, bytes.length - at);
      const page = this.page(number);
      page.bytes.set(bytes.subarray(at, at + n), from);
      this.filled += markBits(page.came, from, from + n);
      at += n;
    }
  }

  /** Where the bytes without a gap end that begin at `from`. */
  gapAfter(from: number): number {
    const { pageSize } = this;
    for (let at = from; ; ) {
      const number = Math.floor(at / pageSize);
      const page = this.pages.get(number);
      if (page === undefined) return at;
      const start = number * pageSize;
      const end = firstGap(page.came, at - start, pageSize);
      if (end < pageSize) return start + end;
      at = start + pageSize;
    }
  }

  /** A copy of the bytes from .. to - 1, which all came. */
  copy(from: number, to: number): Uint8Array {
    const { pageSize } = this;
    const out = new Uint8Array(to - from);
    for (let at = from; at < to; ) {
      const number = Math.floor(at / pageSize);
      const start = number * pageSize;
      const end = Math.min(to, start + pageSize);
      out.set((this.pages.get(number) as Page).bytes.subarray(at - start, end - start), at - from);
      at = end;
    }
    return out;
  }

  /** Calls back with each run of bytes that came: its offset and the bytes. */
  forEachRun(take: (offset: number, bytes: Uint8Array) => void): void {
    const { pageSize } = this;
    for (const [number, { bytes, came }] of this.pages) {
      for (let at = 0; at < pageSize; at++) {
        const end = firstGap(came, at, pageSize);
        if (end > at) take(number * pageSize + at, bytes.subarray(at, end));
        at = end;
      }
    }
  }

  private page(number: number): Page {
    let page = this.pages.get(number);
    if (page === undefined) {
      page = { bytes: new Uint8Array(this.pageSize), came: new Uint32Array((this.pageSize + 31) >>> 5) };
      this.pages.set(number, page);
    }
    return page;
  }
}

/** Sets the bits from .. to - 1, and returns how many were not set before. */
function markBits(bits: Uint32Array, from: number, to: number): number {
  let fresh = 0;
  for (let i = from; i < to; ) {
    if ((i & 31) === 0 && i + 32 <= to && bits[i >>> 5] === 0) {
      bits[i >>> 5] = 0xffffffff;
      fresh += 32;
      i += 32;
      continue;
    }
    const bit = 1 << (i & 31);
    if ((bits[i >>> 5] & bit) === 0) fresh++;
    bits[i >>> 5] |= bit;
    i++;
  }
  return fresh;
}

/** The first bit from `from` on that is not set, at most `end`. */
function firstGap(bits: Uint32Array, from: number, end: number): number {
  let i = from;
  while (i < end && (bits[i >>> 5] >>> (i & 31)) & 1) {
    i += (i & 31) === 0 && i + 32 <= end && bits[i >>> 5] === 0xffffffff ? 32 : 1;
  }
  return i;
}
