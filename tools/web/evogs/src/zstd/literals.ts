/** The literals section of a compressed block (RFC 8878, 3.1.1.3.1). */

import { corrupt } from "./error.js";
import { type HuffmanTable, decodeFourStreams, decodeStream, newHuffmanTable, readTree } from "./huffman.js";

/** A block regenerates at most this. */
export const MAX_BLOCK = 128 * 1024;
const MIN_FOR_FOUR_STREAMS = 6;

/** Literals of blocks, and the tree that a later block of the frame may use again. */
export class Literals {
  readonly bytes = new Uint8Array(MAX_BLOCK);
  length = 0;
  private readonly table: HuffmanTable = newHuffmanTable();
  private hasTable = false;

  /** A new frame begins: it has no tree yet. */
  reset(): void {
    this.hasTable = false;
  }

  /** Reads the section at the beginning of `input[from..to)`, and returns where it ends. */
  read(input: Uint8Array, view: DataView, from: number, to: number, blockMaximum: number): number {
    const head = input[from];
    const type = head & 3;
    const format = (head >> 2) & 3;
    if (type < 2) return this.readPlain(input, view, from, to, blockMaximum, type === 1, format);

    const headerSize = format < 2 ? 3 : format + 2;
    const width = format < 2 ? 10 : 4 * format + 6;
    if (from + headerSize > to) corrupt("the literals header is cut short");
    // Up to 36 bits behind the first four: more than an integer of 32 bits has.
    let bits = 0;
    for (let i = headerSize - 1; i >= 0; i--) bits = bits * 256 + input[from + i];
    bits = Math.floor(bits / 16);
    const size = bits % 2 ** width;
    const compressed = Math.floor(bits / 2 ** width);
    if (size > blockMaximum) corrupt("too many literals");
    if (format > 0 && size < MIN_FOR_FOUR_STREAMS) corrupt("few literals in four streams");
    let at = from + headerSize;
    const end = at + compressed;
    if (end > to) corrupt("the literals are cut short");
    if (type === 2) {
      at = readTree(input, view, at, end, this.table);
      this.hasTable = true;
    } else if (!this.hasTable) {
      corrupt("no Huffman tree to use again");
    }
    this.length = size;
    if (format === 0) decodeStream(this.table, input, view, at, end, this.bytes, 0, size);
    else this.decodeFour(input, view, at, end, size);
    return end;
  }

  private readPlain(
    input: Uint8Array,
    view: DataView,
    from: number,
    to: number,
    blockMaximum: number,
    isRun: boolean,
    format: number,
  ): number {
    const headerSize = format === 1 ? 2 : format === 3 ? 3 : 1;
    const at = from + headerSize;
    if (at > to) corrupt("the literals header is cut short");
    const head = view.getUint32(from, true) & 0xffffff;
    const size = headerSize === 1 ? (head & 0xff) >> 3 : headerSize === 2 ? (head & 0xffff) >> 4 : head >> 4;
    const stored = isRun ? 1 : size;
    if (size > blockMaximum) corrupt("too many literals");
    if (at + stored > to) corrupt("the literals are cut short");
    this.length = size;
    if (isRun) this.bytes.fill(input[at], 0, size);
    else this.bytes.set(input.subarray(at, at + size));
    return at + stored;
  }

  private decodeFour(input: Uint8Array, view: DataView, from: number, to: number, size: number): void {
    if (from + 6 > to) corrupt("the jump table is cut short");
    const starts = [from + 6];
    for (let i = 0; i < 3; i++) starts.push(starts[i] + view.getUint16(from + 2 * i, true));
    if (starts[3] > to) corrupt("a stream of literals is cut short");
    starts.push(to);
    decodeFourStreams(this.table, input, view, starts, this.bytes, size);
  }
}
