/** The walk over the chunks (spec 5.2, 8.1). */

import { viewOf } from "./bytes.js";
import { crc32 } from "./crc32.js";
import { check } from "./faults.js";
import { HEADER_SIZE } from "./header.js";

const CHUNK_HEADER_SIZE = 12;
/** Critical chunks in the order in which they must stand. */
const CRITICAL = ["QUAN", "ALFA", "TILE", "PACK"];
const KNOWN_ANCILLARY = ["dGST", "mETa"];

/** A chunk with its body. `offset` is where the chunk begins in the file. */
export interface Chunk {
  type: string;
  offset: number;
  body: Uint8Array;
}

function isLetter(byte: number): boolean {
  return (byte >= 65 && byte <= 90) || (byte >= 97 && byte <= 122);
}

function isCapital(byte: number): boolean {
  return byte >= 65 && byte <= 90;
}

/**
 * The known chunks by type, with the checks of 6.1, step 2.
 * `bytes` are the chunks_size bytes behind the header. Throws a StreamError.
 */
export function walkChunks(bytes: Uint8Array): Map<string, Chunk> {
  const view = viewOf(bytes);
  const chunks = new Map<string, Chunk>();
  let rank = -1;
  for (let at = 0; at < bytes.length; ) {
    const offset = HEADER_SIZE + at;
    const body = at + CHUNK_HEADER_SIZE;
    check(body <= bytes.length, "E_CHUNK", offset, "the chunk header is cut short");
    const end = body + view.getUint32(at + 4, true);
    check(end <= bytes.length, "E_CHUNK", offset, "the chunk is cut short");
    const crc = crc32(bytes, body, end, crc32(bytes, at, at + 8));
    check(crc === view.getUint32(at + 8, true), "E_CRC", offset);
    const name = bytes.subarray(at, at + 4);
    check(name.every(isLetter) && isCapital(name[2]), "E_CHUNK", offset, "type");
    const type = String.fromCharCode(...name);
    if (CRITICAL.includes(type)) {
      // An equal rank is a repetition, a lower one is out of order.
      const own = CRITICAL.indexOf(type);
      check(own > rank, "E_CHUNK", offset, `${type} is out of order`);
      rank = own;
      chunks.set(type, { type, offset, body: bytes.subarray(body, end) });
    } else if (KNOWN_ANCILLARY.includes(type)) {
      check(!chunks.has(type), "E_CHUNK", offset, `${type} occurs twice`);
      chunks.set(type, { type, offset, body: bytes.subarray(body, end) });
    } else {
      check(!isCapital(name[0]), "E_UNSUPPORTED", offset, `critical chunk ${type}`);
    }
    at = end;
  }
  for (const type of ["QUAN", "TILE", "PACK"]) {
    check(chunks.has(type), "E_CHUNK", HEADER_SIZE, `${type} is missing`);
  }
  return chunks;
}
