/** The blocks of one frame (RFC 8878, 3.1.1.2). Header and block sizes were checked (frames.ts). */

import { PADDING } from "./bits.js";
import { corrupt } from "./error.js";
import { Literals, MAX_BLOCK } from "./literals.js";
import { Sequences } from "./sequences.js";

export { MAX_BLOCK };

/** Decompresses frames, one after the other. It keeps only its own buffers. */
export class FrameDecompressor {
  private readonly literals = new Literals();
  private readonly sequences = new Sequences();
  private input = new Uint8Array(1 << 16);
  private view = new DataView(this.input.buffer);

  /** Decompresses the blocks `bytes` to `out[at..at + size)`, all of it. Throws a ZstdError. */
  run(bytes: Uint8Array, out: Uint8Array, start: number, size: number): void {
    this.load(bytes);
    this.literals.reset();
    this.sequences.reset();
    const blockMaximum = Math.min(MAX_BLOCK, size);
    const end = start + size;
    let at = start;
    for (let p = 0; p < bytes.length; ) {
      const head = this.view.getUint32(p, true) & 0xffffff;
      const type = (head >> 1) & 3;
      const blockSize = head >> 3;
      p += 3;
      if (type === 2) {
        const next = p + blockSize;
        const most = at + Math.min(blockMaximum, end - at);
        const { literals, input, view } = this;
        const sequencesAt = literals.read(input, view, p, next, blockMaximum);
        at = this.sequences.run(input, view, sequencesAt, next, literals, out, start, at, most);
        p = next;
        continue;
      }
      if (blockSize > end - at) corrupt("more bytes than the frame has");
      if (type === 0) out.set(bytes.subarray(p, p + blockSize), at);
      else out.fill(bytes[p], at, at + blockSize);
      at += blockSize;
      p += type === 0 ? blockSize : 1;
    }
    if (at !== end) corrupt("fewer bytes than the frame has");
  }

  /** Bit readers load words that reach past the end, so the input is copied to a larger buffer. */
  private load(bytes: Uint8Array): void {
    if (bytes.length + PADDING > this.input.length) {
      this.input = new Uint8Array(2 * bytes.length + PADDING);
      this.view = new DataView(this.input.buffer);
    }
    this.input.set(bytes);
  }
}
