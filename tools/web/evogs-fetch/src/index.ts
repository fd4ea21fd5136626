/** Fetching EvoGS scenes over HTTP. */

export { type FetchOptions, type FetchState, SceneFetch } from "./sceneFetch.js";
export { FetchError, type FetchFailure } from "./errors.js";
export { type Budget, type Order, fileOrder, viewOrder } from "./order.js";
export type { Planes, View } from "./sight.js";
export { type ByteRange, Intervals } from "./intervals.js";
export { nextRanges } from "./ranges.js";
export { type Point, type Tile, TilesetFetch, type TilesetOptions } from "./tileset.js";
export { type Choice, type TileBudget, type TileView, chooseTiles, screenError, tilesToDraw } from "./tiles.js";
