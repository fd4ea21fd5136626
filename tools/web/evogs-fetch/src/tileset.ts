/** Reads a tileset of streams (docs/tilesets.md): its tiles, in the coordinates of the scene. */

import { Stall, Transient, refusal, waitAfter } from "./answer.js";
import { FetchError } from "./errors.js";
import { sleep } from "./pace.js";

export type Point = readonly [number, number, number];

export interface Tile {
  /** Where the content has its origin, in the scene. */
  readonly origin: Point;
  /** The corners of the box, from that origin. */
  readonly low: Point;
  readonly high: Point;
  /** The geometric error, in units of the scene: what is smaller than that, the content has merged. */
  readonly error: number;
  /** Of the content; null without one. */
  readonly url: string | null;
  /** Splats and bytes of the content, as the tileset says, or 0. */
  readonly splats: number;
  readonly bytes: number;
  readonly parent: Tile | null;
  readonly children: readonly Tile[];
  /** A file of tiles that takes the place of this one: `TilesetFetch.load` gets it. */
  readonly external: string | null;
}

export interface TilesetOptions {
  fetch?: typeof fetch;
  cache?: RequestCache;
  /** Ends `open` and `load`, which reject with its reason. */
  signal?: AbortSignal;
  /** Called when `failure` changes. */
  onFailure?: () => void;
  /** Failures of a file in a row after which it is given up. */
  retries?: number;
  /** An answer without a byte for so long is given up, in seconds. */
  stallSeconds?: number;
  /** The first wait before another try, in ms. It doubles each time, up to 16 times as long. */
  backOff?: number;
}

const MAX_JSON = 1 << 24;
const MAX_TILES = 1_000_000;
const MAX_DEPTH = 64;
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

type Mutable<T> = { -readonly [K in keyof T]: T[K] };
type MutableTile = Mutable<Tile>;

/** The tiles of a tileset. Files of tiles are fetched when they are asked for. */
export class TilesetFetch {
  /** Bytes of JSON that came. */
  received = 0;
  requests = 0;
  /** The connection failed so, and no byte came since then. */
  failure: Error | null = null;
  /** From the content of the root to what is around the tileset: column by column. */
  matrix: readonly number[] = IDENTITY;
  /** Splats and files of all of it, as it says, or 0. */
  splats = 0;
  files = 0;
  private readonly read = new Set<string>();
  private readonly loading = new Map<Tile, Promise<void>>();
  private tiles = 0;
  private readonly url: string;

  constructor(
    url: string,
    private readonly options: TilesetOptions = {},
  ) {
    this.url = new URL(url, globalThis.location?.href).href;
  }

  /** The first tile. Throws a FetchError. */
  async open(): Promise<Tile> {
    const found = await this.json(this.url);
    const own = objectOf(objectOf(found.extras).evogs);
    this.splats = countOf(own.splats);
    this.files = countOf(own.files);
    const origin = own.origin === undefined ? ([0, 0, 0] as Point) : pointOf(numbers(own.origin, 3, "origin"));
    return this.tree(found, this.url, null, origin, 0);
  }

  /** Gets the tiles that a tile stands for, if it has no content of its own. Throws a FetchError. */
  async load(tile: Tile): Promise<void> {
    const known = this.loading.get(tile);
    if (known !== undefined) return known;
    const loaded = this.replace(tile as MutableTile).finally(() => this.loading.delete(tile));
    this.loading.set(tile, loaded);
    return loaded;
  }

  private async replace(tile: MutableTile): Promise<void> {
    while (tile.external !== null) {
      const url = tile.external;
      const inner = this.tree(await this.json(url), url, tile.parent, tile.origin, depthOf(tile));
      const children = inner.children as MutableTile[];
      for (const child of children) child.parent = tile;
      Object.assign(tile, { ...inner, parent: tile.parent, children });
    }
  }

  private async json(url: string): Promise<Record<string, unknown>> {
    if (this.read.has(url)) throw bad("a file of tiles is among its own tiles");
    this.read.add(url);
    let bytes: Uint8Array;
    try {
      bytes = await this.bytes(url);
    } catch (error) {
      this.read.delete(url);
      throw error;
    }
    this.received += bytes.length;
    let found: unknown;
    try {
      found = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
    } catch (error) {
      throw bad(`this is no JSON: ${error instanceof Error ? error.message : error}`);
    }
    const version = objectOf(objectOf(found).asset).version;
    if (version !== "1.0" && version !== "1.1") throw bad("this is no tileset of 3D Tiles 1.0 or 1.1");
    return objectOf(found);
  }

  /** A file as a whole. It is tried again as `SceneFetch` does. */
  private async bytes(url: string): Promise<Uint8Array> {
    const { signal, retries = 6, backOff } = this.options;
    for (let failures = 1; ; failures++) {
      try {
        return await this.ask(url);
      } catch (error) {
        if (!(error instanceof Transient)) throw error;
        this.setFailure(error);
        if (failures > retries) throw new FetchError("lost", error.message, error.status, error);
        await sleep(waitAfter(failures, error, backOff), signal);
      }
    }
  }

  /** Sends a request. Rejects with a FetchError, a Transient, or the reason of `signal`. */
  private async ask(url: string): Promise<Uint8Array> {
    const { fetch: fetchImpl = fetch, cache, signal, stallSeconds } = this.options;
    signal?.throwIfAborted();
    const abort = new AbortController();
    const stop = () => abort.abort(signal?.reason);
    signal?.addEventListener("abort", stop, { once: true });
    const stall = new Stall(abort, stallSeconds);
    this.requests++;
    try {
      const answer = await fetchImpl(url, { cache, signal: abort.signal });
      if (!answer.ok) {
        void answer.body?.cancel().catch(() => {});
        throw refusal(answer);
      }
      return await bounded(answer, () => {
        stall.start();
        this.setFailure(null);
      });
    } catch (error) {
      if (abort.signal.aborted) throw abort.signal.reason;
      if (error instanceof FetchError) throw error;
      throw error instanceof Transient ? error : new Transient(String(error));
    } finally {
      stall.end();
      signal?.removeEventListener("abort", stop);
    }
  }

  private setFailure(failure: Error | null): void {
    if (this.failure === failure) return;
    this.failure = failure;
    this.options.onFailure?.();
  }

  private tree(
    found: Record<string, unknown>,
    url: string,
    outer: Tile | null,
    origin: Point,
    depth: number,
  ): Tile {
    const isRoot = url === this.url;
    const root = this.tile(found.root, url, outer, origin, isRoot);
    const todo: [MutableTile, Record<string, unknown>, number][] = [[root, objectOf(found.root), depth]];
    for (let next = todo.pop(); next !== undefined; next = todo.pop()) {
      const [tile, said, at] = next;
      if (said.children === undefined) continue;
      if (!Array.isArray(said.children)) throw bad("children are no list");
      if (at >= MAX_DEPTH) throw bad(`there are ${MAX_DEPTH} tiles below one another`);
      const children = said.children.map((child) => this.tile(child, url, tile, tile.origin, false));
      tile.children = children;
      children.forEach((child, k) => todo.push([child, objectOf((said.children as unknown[])[k]), at + 1]));
    }
    return root;
  }

  private tile(said: unknown, base: string, parent: Tile | null, from: Point, isRoot: boolean): MutableTile {
    if (++this.tiles > MAX_TILES) throw bad("there are too many tiles");
    if (typeof said !== "object" || said === null || Array.isArray(said)) throw bad("a tile is no object");
    const tile = said as Record<string, unknown>;
    if ("contents" in tile || "implicitTiling" in tile) throw bad("tiles with several or implicit contents");
    const m = tile.transform === undefined ? IDENTITY : numbers(tile.transform, 16, "transform");
    let origin = from;
    if (isRoot) this.matrix = m;
    else {
      if (IDENTITY.some((x, k) => (k < 12 || k === 15) && m[k] !== x)) throw bad("a tile is turned or scaled");
      origin = [from[0] + m[12], from[1] + m[13], from[2] + m[14]];
    }
    const box = numbers(objectOf(tile.boundingVolume).box, 12, "box");
    const half = [0, 1, 2].map((a) => Math.abs(box[3 + a]) + Math.abs(box[6 + a]) + Math.abs(box[9 + a]));
    const [error] = numbers([tile.geometricError], 1, "geometricError");
    if (error < 0) throw bad("a geometric error is negative");
    const content = objectOf(tile.content);
    const extras = objectOf(content.extras);
    const url = content.uri === undefined ? null : this.resolve(content.uri, base);
    const isTiles = url !== null && new URL(url).pathname.toLowerCase().endsWith(".json");
    return {
      origin,
      low: pointOf(half.map((h, a) => box[a] - h)),
      high: pointOf(half.map((h, a) => box[a] + h)),
      error,
      url: isTiles ? null : url,
      splats: countOf(extras.splats),
      bytes: countOf(extras.bytes),
      parent,
      children: [],
      external: isTiles ? url : null,
    };
  }

  /** The address of a content, which is in the folder of the tileset. */
  private resolve(uri: unknown, base: string): string {
    if (typeof uri !== "string") throw bad("the uri of a content is no text");
    const folder = new URL(".", this.url);
    const url = URL.canParse(uri, base) ? new URL(uri, base) : null;
    const isWithin = url !== null && url.origin === folder.origin && url.pathname.startsWith(folder.pathname);
    if (!isWithin || url.protocol !== folder.protocol) throw bad("a content is not in the folder of the tileset");
    return url.href;
  }
}

async function bounded(answer: Response, onBytes: () => void): Promise<Uint8Array> {
  const parts: Uint8Array[] = [];
  let size = 0;
  const reader = answer.body?.getReader();
  while (reader !== undefined) {
    const { done, value } = await reader.read();
    if (done) break;
    onBytes();
    size += value.length;
    if (size > MAX_JSON) {
      void reader.cancel().catch(() => {});
      throw bad("the JSON is too large");
    }
    parts.push(value);
  }
  const all = new Uint8Array(size);
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

function depthOf(tile: Tile): number {
  let depth = 0;
  for (let above = tile.parent; above !== null; above = above.parent) depth++;
  return depth;
}

function bad(what: string): FetchError {
  return new FetchError("bad", `this is no tileset that can be shown: ${what}`);
}

function objectOf(value: unknown): Record<string, unknown> {
  return typeof value === "object" && value !== null ? (value as Record<string, unknown>) : {};
}

function numbers(value: unknown, n: number, name: string): number[] {
  const isRight = Array.isArray(value) && value.length === n && value.every((x) => Number.isFinite(x));
  if (!isRight) throw bad(`${name} is not ${n} numbers`);
  return value as number[];
}

function countOf(value: unknown): number {
  return Number.isSafeInteger(value) && (value as number) >= 0 ? (value as number) : 0;
}

function pointOf([x, y, z]: readonly number[]): Point {
  return [x, y, z];
}
