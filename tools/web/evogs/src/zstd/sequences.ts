/** The sequences section of a compressed block, and its execution (RFC 8878, 3.1.1.3.2, 3.1.1.4, 3.1.1.5). */

import { BackwardBits } from "./bits.js";
import {
  LL_BASE,
  LL_BITS,
  LL_DEFAULT,
  MAX_LL,
  MAX_ML,
  MAX_OF,
  ML_BASE,
  ML_BITS,
  ML_DEFAULT,
  OF_DEFAULT,
} from "./codes.js";
import { corrupt } from "./error.js";
import { type FseTable, newFseTable, readTable, setSingle } from "./fse.js";
import type { Literals } from "./literals.js";

/** An offset of this many bits is above any frame: 16 MiB (R-5.10-4). */
const TOO_MANY_BITS = 25;
/** Below this many bytes a loop is faster than a call. */
const SHORT = 24;
/** Bits that a load of four bytes has at the least. */
const AT_ONCE = 25;

/** Codes of one kind: where their tables come from. */
interface Kind {
  own: FseTable;
  standard: FseTable;
  maxLog: number;
  maxSymbol: number;
}

/** What the blocks of a frame hand on: tables and repeated offsets. */
export class Sequences {
  private readonly ll: Kind = { own: newFseTable(9), standard: LL_DEFAULT, maxLog: 9, maxSymbol: MAX_LL };
  private readonly of: Kind = { own: newFseTable(8), standard: OF_DEFAULT, maxLog: 8, maxSymbol: MAX_OF };
  private readonly ml: Kind = { own: newFseTable(9), standard: ML_DEFAULT, maxLog: 9, maxSymbol: MAX_ML };
  private tables: [FseTable, FseTable, FseTable] | null = null;
  private rep1 = 1;
  private rep2 = 4;
  private rep3 = 8;

  /** A new frame begins. */
  reset(): void {
    this.tables = null;
    this.rep1 = 1;
    this.rep2 = 4;
    this.rep3 = 8;
  }

  /**
   * Reads the section `input[from..to)` and writes the block to `out[at..end)`, or less.
   * Matches may reach back to `start`. Returns where the block ends.
   */
  run(
    input: Uint8Array,
    view: DataView,
    from: number,
    to: number,
    literals: Literals,
    out: Uint8Array,
    start: number,
    at: number,
    end: number,
  ): number {
    let p = from;
    if (p >= to) corrupt("no number of sequences");
    let count = input[p++];
    if (count === 255) {
      if (p + 2 > to) corrupt("the number of sequences is cut short");
      count = view.getUint16(p, true) + 0x7f00;
      p += 2;
    } else if (count > 127) {
      if (p >= to) corrupt("the number of sequences is cut short");
      count = ((count - 128) << 8) + input[p++];
    }
    let done = { at, literal: 0 };
    if (count === 0) {
      // R-5.10-11: a 0 in two bytes is as good as one in a byte.
      if (p !== to) corrupt("bytes behind a block without sequences");
    } else {
      if (p >= to) corrupt("no compression modes");
      const modes = input[p++];
      if (modes & 3) corrupt("reserved bits of the compression modes");
      p = this.readTables(input, modes, p, to);
      const bits = new BackwardBits(view, input, p, to);
      done = this.execute(bits, count, literals, out, start, at, end);
    }
    const rest = literals.length - done.literal;
    if (rest > end - done.at) corrupt("a block is too large");
    out.set(literals.bytes.subarray(done.literal, literals.length), done.at);
    return done.at + rest;
  }

  private readTables(input: Uint8Array, modes: number, from: number, to: number): number {
    let p = from;
    const read = (kind: Kind, mode: number, before: FseTable | undefined): FseTable => {
      if (mode === 0) return kind.standard;
      if (mode === 3) return before ?? corrupt("no table to use again");
      if (mode === 1) {
        if (p >= to || input[p] > kind.maxSymbol) corrupt("the symbol of a run");
        setSingle(kind.own, input[p++]);
      } else {
        p = readTable(input, p, to, kind.own, kind.maxLog, kind.maxSymbol);
      }
      return kind.own;
    };
    const before = this.tables;
    const ll = read(this.ll, modes >> 6, before?.[0]);
    const of = read(this.of, (modes >> 4) & 3, before?.[1]);
    const ml = read(this.ml, (modes >> 2) & 3, before?.[2]);
    this.tables = [ll, of, ml];
    return p;
  }

  private execute(
    bits: BackwardBits,
    count: number,
    literals: Literals,
    out: Uint8Array,
    start: number,
    from: number,
    end: number,
  ): { at: number; literal: number } {
    const [llTable, ofTable, mlTable] = this.tables as [FseTable, FseTable, FseTable];
    const llEntries = llTable.entries;
    const ofEntries = ofTable.entries;
    const mlEntries = mlTable.entries;
    const source = literals.bytes;
    const nLiterals = literals.length;
    let ll = llEntries[bits.read(llTable.log)];
    let of = ofEntries[bits.read(ofTable.log)];
    let ml = mlEntries[bits.read(mlTable.log)];
    // What `bits` does is written out here: this loop runs for each few bytes of a stream.
    const { view, from: first } = bits;
    let { left } = bits;
    let { rep1, rep2, rep3 } = this;
    let at = from;
    let literal = 0;
    for (let i = count; ; ) {
      const ofBits = of & 255;
      const mlCode = ml & 255;
      const llCode = ll & 255;
      if (ofBits >= TOO_MANY_BITS) corrupt("an offset before the frame");
      const mlBits = ML_BITS[mlCode];
      const llBits = LL_BITS[llCode];
      let ofValue = 1 << ofBits;
      let matchLength = ML_BASE[mlCode];
      let literalLength = LL_BASE[llCode];
      const extra = ofBits + mlBits + llBits;
      if (extra > left) corrupt("a bit stream ends early");
      left -= extra;
      if (extra <= AT_ONCE) {
        const word = view.getInt32(first + (left >> 3), true) >>> (left & 7);
        literalLength += word & ((1 << llBits) - 1);
        matchLength += (word >>> llBits) & ((1 << mlBits) - 1);
        ofValue += (word >>> (llBits + mlBits)) & ((1 << ofBits) - 1);
      } else {
        literalLength += bitsAt(view, first, left, llBits);
        matchLength += bitsAt(view, first, left + llBits, mlBits);
        ofValue += bitsAt(view, first, left + llBits + mlBits, ofBits);
      }

      // Repeated offsets (R-5.10-7).
      let offset = ofValue - 3;
      if (ofValue > 3) {
        rep3 = rep2;
        rep2 = rep1;
        rep1 = offset;
      } else {
        const index = literalLength === 0 ? ofValue + 1 : ofValue;
        offset = index === 1 ? rep1 : index === 2 ? rep2 : index === 3 ? rep3 : rep1 - 1;
        if (index > 2) rep3 = rep2;
        if (index > 1) rep2 = rep1;
        rep1 = offset;
      }

      if (literalLength > nLiterals - literal) corrupt("more literals than there are");
      if (literalLength + matchLength > end - at) corrupt("a block is too large");
      copyLiterals(source, literal, out, at, literalLength);
      literal += literalLength;
      at += literalLength;
      if (offset === 0 || offset > at - start) corrupt("an offset before the frame");
      copyMatch(out, at, offset, matchLength);
      at += matchLength;

      if (--i === 0) break;
      const llNext = (ll >>> 8) & 255;
      const mlNext = (ml >>> 8) & 255;
      const ofNext = (of >>> 8) & 255;
      const next = llNext + mlNext + ofNext;
      if (next > left) corrupt("a bit stream ends early");
      left -= next;
      if (next <= AT_ONCE) {
        const word = view.getInt32(first + (left >> 3), true) >>> (left & 7);
        of = ofEntries[(of >>> 16) + (word & ((1 << ofNext) - 1))];
        ml = mlEntries[(ml >>> 16) + ((word >>> ofNext) & ((1 << mlNext) - 1))];
        ll = llEntries[(ll >>> 16) + ((word >>> (ofNext + mlNext)) & ((1 << llNext) - 1))];
      } else {
        of = ofEntries[(of >>> 16) + bitsAt(view, first, left, ofNext)];
        ml = mlEntries[(ml >>> 16) + bitsAt(view, first, left + ofNext, mlNext)];
        ll = llEntries[(ll >>> 16) + bitsAt(view, first, left + ofNext + mlNext, llNext)];
      }
    }
    if (left !== 0) corrupt("bits are left behind the sequences");
    this.rep1 = rep1;
    this.rep2 = rep2;
    this.rep3 = rep3;
    return { at, literal };
  }
}

/** The `n` bits, 0 to 24, above bit `at` of a stream that begins at `from`. */
function bitsAt(view: DataView, from: number, at: number, n: number): number {
  return (view.getInt32(from + (at >> 3), true) >>> (at & 7)) & ((1 << n) - 1);
}

function copyLiterals(from: Uint8Array, at: number, out: Uint8Array, to: number, n: number): void {
  if (n > SHORT) out.set(from.subarray(at, at + n), to);
  else for (let i = 0; i < n; i++) out[to + i] = from[at + i];
}

/** A match may overlap what it writes. */
function copyMatch(out: Uint8Array, at: number, offset: number, n: number): void {
  if (n <= SHORT) for (let i = 0; i < n; i++) out[at + i] = out[at - offset + i];
  else if (offset === 1) out.fill(out[at - 1], at, at + n);
  else if (offset >= n) out.copyWithin(at, at - offset, at - offset + n);
  else {
    // What was copied doubles what may be copied next.
    for (let done = 0, have = offset; done < n; have *= 2) {
      const part = Math.min(have, n - done);
      out.copyWithin(at + done, at - offset, at - offset + part);
      done += part;
    }
  }
}
