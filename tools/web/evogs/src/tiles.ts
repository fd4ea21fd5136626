/** `TILE`: the tile table (spec 5.5). */

import { viewOf } from "./bytes.js";
import type { Chunk } from "./chunks.js";
import { check } from "./faults.js";
import type { Header } from "./header.js";

const ROW_SIZE = 48;
const MAX_ORIGIN = 2 ** 52;
/** Numbers of splats are within +-MAX_X (R-7.3-3). */
export const MAX_X = 2 ** 30 - 1;

/** Numbers of tile t and axis a stand at 3 * t + a. Units are those of the position grid. */
export interface TileTable {
  /** O of each position channel: integers, exact in a double. */
  origin: Float64Array;
  /** The least and largest X, without the origin. */
  boxMin: Int32Array;
  boxMax: Int32Array;
}

export function parseTiles(chunk: Chunk, header: Header): TileTable {
  const { body, offset } = chunk;
  const n = header.nTiles;
  check(body.length === n * ROW_SIZE, "E_CHUNK", offset, "size of TILE");
  const view = viewOf(body);
  const table: TileTable = {
    origin: new Float64Array(3 * n),
    boxMin: new Int32Array(3 * n),
    boxMax: new Int32Array(3 * n),
  };
  for (let t = 0; t < n; t++) {
    const row = t * ROW_SIZE;
    for (let axis = 0; axis < 3; axis++) {
      const i = 3 * t + axis;
      const at = row + 8 * axis;
      // Rounding of the sum moves no number across the bound, which is a power of two.
      const origin = view.getInt32(at + 4, true) * 2 ** 32 + view.getUint32(at, true);
      check(Math.abs(origin) <= MAX_ORIGIN, "E_TILE", offset, "origin");
      table.origin[i] = origin;
      const least = view.getInt32(row + 24 + 4 * axis, true);
      const most = view.getInt32(row + 36 + 4 * axis, true);
      check(-MAX_X <= least && least <= most && most <= MAX_X, "E_TILE", offset, "box");
      table.boxMin[i] = least;
      table.boxMax[i] = most;
    }
  }
  return table;
}
