/** Which tiles of a tileset are wanted for a view, and which are drawn until these have come. */

import { type Planes, isInSight } from "./sight.js";
import type { Point, Tile } from "./tileset.js";

/** What is looked at, in the coordinates of the scene. */
export interface TileView {
  eye: Point;
  planes: Planes;
  /** Pixels of something of size 1 at distance 1: the height of the picture over 2 tan(fovY / 2). */
  pixels: number;
}

export interface TileBudget {
  /** Splats of all contents that are drawn. */
  splats?: number;
  /** Bytes of these. */
  bytes?: number;
  /** Pixels: a tile whose error looks smaller is not replaced by its children. */
  error?: number;
}

export interface Choice {
  /** Whose contents are wanted; none is below another. The most urgent first. */
  tiles: Tile[];
  /** Whose files of tiles are wanted, by `TilesetFetch.load`; then choose again. */
  load: Tile[];
}

/**
 * Starts with the overview of the root, and replaces tiles by their children: those first whose error looks
 * largest, while what is wanted fits in the budget. Tiles out of sight are not wanted; the root always is.
 */
export function chooseTiles(root: Tile, view: TileView, budget: TileBudget = {}): Choice {
  const { splats = Number.POSITIVE_INFINITY, bytes = Number.POSITIVE_INFINITY, error = 16 } = budget;
  const load: Tile[] = [];
  const done: [Tile, number][] = [];
  const open: [Tile, number][] = [[root, screenError(root, view)]];
  let nSplats = root.splats;
  let nBytes = root.bytes;
  while (open.length > 0) {
    let at = 0;
    for (let k = 1; k < open.length; k++) if (open[k][1] > open[at][1]) at = k;
    const [entry] = open.splice(at, 1);
    const [tile, looks] = entry;
    if (tile.external !== null) {
      load.push(tile);
      continue;
    }
    const isCoarse = looks > error || tile.url === null;
    const children = isCoarse ? tile.children.filter((child) => isSeen(child, view)) : [];
    const moreSplats = children.reduce((n, child) => n + child.splats, 0) - tile.splats;
    const moreBytes = children.reduce((n, child) => n + child.bytes, 0) - tile.bytes;
    const fits = nSplats + moreSplats <= splats && nBytes + moreBytes <= bytes;
    if (children.length === 0 || (!fits && tile.url !== null)) {
      if (tile.url !== null) done.push([tile, looks]);
      continue;
    }
    nSplats += moreSplats;
    nBytes += moreBytes;
    for (const child of children) open.push([child, screenError(child, view)]);
  }
  // A leaf has no error: of such the nearest comes first.
  const nearness = ([tile]: [Tile, number]) => distanceTo(tile, view.eye);
  done.sort((a, b) => b[1] - a[1] || nearness(a) - nearness(b));
  return { tiles: done.map(([tile]) => tile), load };
}

/**
 * What to draw of the contents that have come: of each wanted one itself or, until it is there, what is nearest above
 * it. Nothing is drawn twice: an overview stays until all that is wanted below it has come.
 */
export function tilesToDraw(wanted: readonly Tile[], isReady: (tile: Tile) => boolean): Tile[] {
  const drawn = new Set<Tile>();
  for (const tile of wanted) {
    let found: Tile | null = tile;
    while (found !== null && !isReady(found)) found = found.parent;
    if (found !== null) drawn.add(found);
  }
  return [...drawn].filter((tile) => {
    for (let above = tile.parent; above !== null; above = above.parent) if (drawn.has(above)) return false;
    return true;
  });
}

/** Pixels that the error of a tile looks like from the point of its box that is nearest. */
export function screenError(tile: Tile, view: TileView): number {
  if (tile.error === 0) return 0;
  const distance = distanceTo(tile, view.eye);
  return distance === 0 ? Number.POSITIVE_INFINITY : (tile.error * view.pixels) / distance;
}

function distanceTo({ origin, low, high }: Tile, eye: Point): number {
  let sum = 0;
  for (let a = 0; a < 3; a++) {
    const x = eye[a] - origin[a];
    sum += Math.max(low[a] - x, 0, x - high[a]) ** 2;
  }
  return Math.sqrt(sum);
}

function isSeen({ origin, low, high }: Tile, { planes }: TileView): boolean {
  const [x, y, z] = origin;
  const at = (corner: Point): Point => [x + corner[0], y + corner[1], z + corner[2]];
  return isInSight(at(low), at(high), planes);
}
