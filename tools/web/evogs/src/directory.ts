/** The directory: header and chunks together (spec 5, 6.1 steps 1 to 3). */

import { type AlphaTables, parseAlphaTables } from "./alpha.js";
import { type Chunk, walkChunks } from "./chunks.js";
import { type Digests, parseDigests } from "./digests.js";
import { check } from "./faults.js";
import { HEADER_SIZE, type Header, parseHeader } from "./header.js";
import type { Limits } from "./limits.js";
import { parseMetadata } from "./metadata.js";
import { type PacketTable, parsePacketTable } from "./packetTable.js";
import { type Quantisers, parseQuantisers } from "./quantisers.js";
import { type TileTable, parseTiles } from "./tiles.js";

export interface Directory {
  header: Header;
  quantisers: Quantisers;
  alpha: AlphaTables;
  tiles: TileTable;
  packets: PacketTable;
  digests: Digests | null;
  metadata: Map<string, string>;
}

/** Reads all chunks of a file whose header was read. `chunks` are the chunks_size bytes behind it. */
export function parseChunks(header: Header, chunks: Uint8Array, limits: Limits = {}): Directory {
  const found = walkChunks(chunks);
  const get = (type: string) => found.get(type) as Chunk;
  const quantisers = parseQuantisers(get("QUAN"), header);
  const alpha = parseAlphaTables(found.get("ALFA"), header);
  const tiles = parseTiles(get("TILE"), header);
  const packets = parsePacketTable(get("PACK"), header, limits);
  const digests = parseDigests(found.get("dGST"), header, packets);
  const metadata = parseMetadata(found.get("mETa"));
  return { header, quantisers, alpha, tiles, packets, digests, metadata };
}

/** Reads header and chunks from the beginning of a file. Throws the first fault of 6.1, steps 1 to 3. */
export function parseDirectory(bytes: Uint8Array, limits: Limits = {}): Directory {
  const header = parseHeader(bytes, limits);
  const end = HEADER_SIZE + header.chunksSize;
  check(bytes.length >= end, "E_TRUNCATED", HEADER_SIZE);
  return parseChunks(header, bytes.subarray(HEADER_SIZE, end), limits);
}
