/** Frames of a packet: what is checked before they are decompressed (spec 5.10). */

import { u64, viewOf } from "./bytes.js";
import { StreamError, check } from "./faults.js";
import { ZstdError } from "./zstd/error.js";
import { FrameDecompressor, MAX_BLOCK } from "./zstd/frame.js";

const MAGIC = 0xfd2fb528;
const MAX_CONTENT = 16 * 1024 * 1024;
const RAW = 0;
const RUN = 1;
const RESERVED = 3;

const decompressor = new FrameDecompressor();

/**
 * Decompresses a frame, which must regenerate the `planes` bytes of its planes, to `out` at `at`.
 * `offset` is that of the packet. Throws E_FRAME before E_ZSTD.
 */
export function decompressFrame(
  frame: Uint8Array,
  planes: number,
  out: Uint8Array,
  at: number,
  offset: number,
): void {
  const blocks = checkFrame(frame, planes, offset);
  try {
    decompressor.run(frame.subarray(blocks), out, at, planes);
  } catch (error) {
    if (error instanceof ZstdError) throw new StreamError("E_ZSTD", offset, error.message);
    throw error;
  }
}

/** Checks R-5.10-1 to R-5.10-5, and returns where the blocks begin. */
export function checkFrame(frame: Uint8Array, planes: number, offset: number): number {
  const view = viewOf(frame);
  check(frame.length >= 5 && view.getUint32(0, true) === MAGIC, "E_FRAME", offset, "magic number");
  const descriptor = frame[4];
  check((descriptor & 0x3f) === 0x20, "E_FRAME", offset, "descriptor");
  const width = 1 << (descriptor >> 6);
  const blocks = 5 + width;
  check(frame.length >= blocks, "E_FRAME", offset, "Frame_Content_Size");
  const content =
    width === 1
      ? frame[5]
      : width === 2
        ? view.getUint16(5, true) + 256
        : width === 4
          ? view.getUint32(5, true)
          : u64(view, 5);
  check(content === planes, "E_FRAME", offset, "Frame_Content_Size is not the size of the planes");
  check(content <= MAX_CONTENT, "E_FRAME", offset, "Frame_Content_Size");

  const maximum = Math.min(MAX_BLOCK, content);
  let isLast = false;
  let p = blocks;
  while (!isLast) {
    check(p + 3 <= frame.length, "E_FRAME", offset, "a block header is cut short");
    const type = (frame[p] >> 1) & 3;
    const size = (frame[p] >> 3) | (frame[p + 1] << 5) | (frame[p + 2] << 13);
    isLast = (frame[p] & 1) === 1;
    check(type !== RESERVED && size <= maximum, "E_FRAME", offset, "type or size of a block");
    check(size > 0 || (type === RAW && isLast), "E_FRAME", offset, "an empty block");
    p += 3 + (type === RUN ? 1 : size);
    check(p <= frame.length, "E_FRAME", offset, "a block is cut short");
  }
  check(p === frame.length, "E_FRAME", offset, "bytes behind the last block");
  return blocks;
}
