/** Small streams for tests, made by the text of the format. Frames are raw blocks. */

import { crc32 } from "../dist/index.js";

export const CORE = 0;
export const PICKS = 4;
export const PALETTE = 5;

export function join(...parts) {
  const bytes = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    bytes.set(part, at);
    at += part.length;
  }
  return bytes;
}

function integers(size, put) {
  const bytes = new Uint8Array(size);
  put(new DataView(bytes.buffer));
  return bytes;
}

export const u32 = (...values) =>
  integers(4 * values.length, (view) => values.forEach((v, i) => view.setUint32(4 * i, v, true)));

export const ascii = (text) => new TextEncoder().encode(text);

function chunk(type, body) {
  const head = join(ascii(type), u32(body.length));
  return join(head, u32(crc32(join(head, body))), body);
}

/** A Zstandard frame of raw blocks. */
export function rawFrame(content) {
  const parts = [u32(0xfd2fb528), Uint8Array.of(0xa0), u32(content.length)];
  const most = Math.min(128 * 1024, content.length);
  for (let at = 0; at < content.length; at += most) {
    const part = content.subarray(at, at + most);
    const isLast = at + most >= content.length ? 1 : 0;
    parts.push(u32(isLast | (part.length << 3)).subarray(0, 3), part);
  }
  return join(...parts);
}

/** A frame that repeats one byte. */
export function runFrame(byte, size) {
  const parts = [u32(0xfd2fb528), Uint8Array.of(0xa0), u32(size)];
  const most = Math.min(128 * 1024, size);
  for (let at = 0; at < size; at += most) {
    const n = Math.min(most, size - at);
    parts.push(u32((at + n === size ? 1 : 0) | 2 | (n << 3)).subarray(0, 3), Uint8Array.of(byte));
  }
  return join(...parts);
}

/**
 * A packet with `nLists` lists. `planes` has the coding byte and the planes of a list by its number,
 * and how many they are, if not one. Planes that are given as a number of bytes are a run of ones.
 */
export function packet(nLists, planes = {}, flags = 0) {
  const coding = new Uint8Array(nLists);
  const frames = [];
  const counts = [];
  for (const [list, [code, plane, count]] of Object.entries(planes)) {
    coding[list] = code;
    counts.push(count ?? 1);
    frames.push(typeof plane === "number" ? runFrame(1, plane) : rawFrame(Uint8Array.from(plane)));
  }
  const entries = frames.map((frame, i) => join(Uint8Array.of(counts[i]), u32(frame.length)));
  return join(Uint8Array.of(flags, frames.length), coding, ...entries, ...frames);
}

/** A core packet: 2 + 5 + 14 + 14 lists. */
export const core = (planes, flags) => packet(35, planes, flags);

function header({ tier = 3, shDegree = 0, nLevels = 1, flags = 0, nTiles, nPackets, chunksSize, dataSize }) {
  const head = integers(60, (view) => {
    view.setUint16(18, flags, true);
    view.setUint32(24, nTiles, true);
    view.setUint32(28, nPackets, true);
    view.setUint32(32, chunksSize, true);
    view.setBigUint64(36, BigInt(dataSize), true);
  });
  head.set([0x89, 0x45, 0x56, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 1, 0, tier, shDegree, nLevels]);
  return join(head, u32(crc32(head)));
}

/**
 * A stream. All quantisers are 1, or `mantissa`, all grids 2^0, boxes as wide as they may be.
 * `rows` are packets: {tile, component, level, adds, splits, refines, drops, bytes}.
 */
export function stream({ nTiles = 1, shDegree = 0, nLevels = 1, hasPalette = false, rows, tier, mantissa = 1 }) {
  const quan = new Uint8Array(3 * (1 + nLevels) * (5 + shDegree));
  for (let i = 0; i < quan.length; i += 3) quan.set([mantissa & 255, mantissa >> 8], i);
  const most = 2 ** 30 - 1;
  const tile = join(new Uint8Array(24), u32(-most >>> 0, -most >>> 0, -most >>> 0, most, most, most));
  const tiles = join(...Array.from({ length: nTiles }, () => tile));
  const pack = join(
    ...rows.map((row) => {
      const { tile = 0, component = CORE, level = 0, adds = 0, splits = 0, refines = 0, drops = 0, bytes } = row;
      const size = bytes?.length ?? 0;
      return join(
        u32(tile),
        Uint8Array.of(component, level, 0, 0),
        u32(size, adds, splits, refines, drops, 0xffffffff, size ? crc32(bytes) : 0),
      );
    }),
  );
  const chunks = join(chunk("QUAN", quan), chunk("TILE", tiles), chunk("PACK", pack));
  const data = join(...rows.map((row) => row.bytes ?? new Uint8Array(0)));
  const flags = hasPalette ? 0x100 : 0;
  const sizes = { nTiles, nPackets: rows.length, chunksSize: chunks.length, dataSize: data.length };
  return join(header({ tier, shDegree, nLevels, flags, ...sizes }), chunks, data);
}

/** Numbers by chance, the same in each run. */
export function chance(seed) {
  let state = seed >>> 0;
  return (below) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * below);
  };
}
