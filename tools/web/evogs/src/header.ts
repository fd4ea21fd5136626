/** The file header (spec 5.1). */

import { u64, viewOf } from "./bytes.js";
import { crc32 } from "./crc32.js";
import { check } from "./faults.js";
import { LimitChecker, type Limits } from "./limits.js";

export const HEADER_SIZE = 64;
const SIGNATURE = [0x89, 0x45, 0x56, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
/** The bits of `flags` that are reserved. Bits 1..7 are unused, and ignored. */
const RESERVED_FLAGS = 0xfe00;

export interface Header {
  versionMinor: number;
  /** 1, 2 or 3: the limits that the stream keeps (8.2). */
  tier: number;
  shDegree: number;
  nLevels: number;
  /** G of position, rotation, scale, opacity, SH: a number X stands for (O + X) * 2^-G. */
  gridExponents: Int8Array;
  flags: number;
  /** The scene was made for an antialiased renderer. */
  isAntialiased: boolean;
  hasPalette: boolean;
  /** Registry values (8.4). Unknown values were read as 0. */
  coordinateSystem: number;
  upAxis: number;
  unit: number;
  colourSpace: number;
  nTiles: number;
  nPackets: number;
  /** Bytes of all chunks. */
  chunksSize: number;
  /** Bytes of all packets. Exact below 2^53. */
  dataSize: number;
  /** The two halves of `data_size`, which are always exact. */
  dataSizeLow: number;
  dataSizeHigh: number;
}

/** Throws E_SIGNATURE with the first byte that differs. `bytes` may be any beginning of a file. */
export function checkSignature(bytes: Uint8Array): void {
  for (let i = 0; i < Math.min(8, bytes.length); i++) check(bytes[i] === SIGNATURE[i], "E_SIGNATURE", 0);
}

/** A value of a registry whose values are 0 to `last`. */
function registered(value: number, last: number): number {
  return value <= last ? value : 0;
}

/**
 * Reads the header from the beginning of a file, with the checks of 6.1, step 1.
 * Throws a StreamError at offset 0.
 */
export function parseHeader(bytes: Uint8Array, limits: Limits = {}): Header {
  checkSignature(bytes);
  check(bytes.length >= HEADER_SIZE, "E_TRUNCATED", 0);
  const view = viewOf(bytes);
  check(bytes[8] === 1, "E_VERSION", 0);
  check(crc32(bytes, 0, 60) === view.getUint32(60, true), "E_CRC", 0);
  const flags = view.getUint16(18, true);
  check((flags & RESERVED_FLAGS) === 0, "E_RESERVED", 0, "flags");
  for (let i = 44; i < 60; i++) check(bytes[i] === 0, "E_RESERVED", 0, "reserved");
  const header: Header = {
    versionMinor: bytes[9],
    tier: bytes[10],
    shDegree: bytes[11],
    nLevels: bytes[12],
    gridExponents: new Int8Array(bytes.slice(13, 18)),
    flags,
    isAntialiased: (flags & 1) !== 0,
    hasPalette: (flags & 0x100) !== 0,
    coordinateSystem: registered(bytes[20], 5),
    upAxis: registered(bytes[21], 6),
    unit: registered(bytes[22], 5),
    colourSpace: registered(bytes[23], 2),
    nTiles: view.getUint32(24, true),
    nPackets: view.getUint32(28, true),
    chunksSize: view.getUint32(32, true),
    dataSize: u64(view, 36),
    dataSizeLow: view.getUint32(36, true),
    dataSizeHigh: view.getUint32(40, true),
  };
  check(header.tier >= 1 && header.tier <= 3, "E_HEADER", 0, "tier");
  check(header.shDegree <= 3, "E_HEADER", 0, "sh_degree");
  check(header.nLevels >= 1, "E_HEADER", 0, "n_levels");
  for (const g of header.gridExponents) check(g >= -16 && g <= 40, "E_HEADER", 0, "grid exponent");
  check(!header.hasPalette || header.shDegree > 0, "E_HEADER", 0, "a palette without SH (R-5.1-9)");
  const checker = new LimitChecker(header.tier, limits);
  checker.check("n_levels", header.nLevels, 0);
  checker.check("n_tiles", header.nTiles, 0);
  checker.check("n_packets", header.nPackets, 0);
  checker.check("chunks_size", header.chunksSize, 0);
  return header;
}
