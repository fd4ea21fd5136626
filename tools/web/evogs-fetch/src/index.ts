/** Fetching EvoGS scenes over HTTP. */

export { type FetchOptions, type FetchState, SceneFetch } from "./sceneFetch.js";
export { FetchError, type FetchFailure } from "./errors.js";
export { type Budget, type Order, type View, fileOrder, viewOrder } from "./order.js";
export { type ByteRange, Intervals } from "./intervals.js";
export { nextRanges } from "./ranges.js";
