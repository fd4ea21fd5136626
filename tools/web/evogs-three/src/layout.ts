/** Where the splats of a scene stand in textures. */

import type { Directory } from "evogs";

/**
 * A texture for core, and one for each SH band. A splat stands at the same column and row in all of them,
 * and takes some texels of four 32-bit words each.
 */
export const TEXELS = [2, 2, 2, 3] as const;

/** The texture that says from where splats grow while a step is shown: a word for each splat. */
export const SOURCES = TEXELS.length;

export interface Layout {
  /** Splats in a row. A row belongs to one tile. */
  width: number;
  /** Rows of all tiles, when all slots are there. */
  rows: number;
  shDegree: number;
  isAntialiased: boolean;
}

const NARROWEST = 256;

/** A layout that fits in textures of `most` columns and rows. Throws a RangeError if none does. */
export function layoutOf(directory: Directory, most = 4096): Layout {
  const { header, packets } = directory;
  const slots = new Float64Array(header.nTiles);
  for (let i = 0; i < packets.length; i++) {
    if (packets.component[i] === 0) slots[packets.tile[i]] = packets.slotsAfter[i];
  }
  const { shDegree, isAntialiased } = header;
  const widest = most / Math.max(...TEXELS.slice(0, shDegree + 1));
  const rowsAt = (width: number) => slots.reduce((rows, n) => rows + Math.ceil(n / width), 0);
  // Wider while it is far from a square: short rows waste less at the end of a tile.
  let width = NARROWEST;
  while (2 * width <= widest && (rowsAt(width) > 4 * width || rowsAt(width) > most)) width *= 2;
  const rows = rowsAt(width);
  if (rows > most) throw new RangeError(`${rows} rows of ${width} splats do not fit in textures of ${most} rows`);
  return { width, rows: Math.max(rows, 1), shDegree, isAntialiased };
}
