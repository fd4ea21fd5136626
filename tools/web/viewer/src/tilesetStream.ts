/** A tileset that comes: the overview first, then files for what is looked at. Runs in the worker. */

import type { Limits } from "evogs";
import { FetchError, type Point, type Tile, TilesetFetch, chooseTiles, tilesToDraw } from "evogs-fetch";
import { BoundsWatch } from "./bounds.js";
import { Content } from "./content.js";
import { LIMITS } from "./limits.js";
import type { EyeAndPlanes, Progress, Wants } from "./messages.js";
import { originFetch } from "./originFetch.js";
import { type Post, UP_AXES, levelOf } from "./stream.js";
import { decoded } from "./words.js";

/** Splats of all files together, if the panel sets no bound: about 1 GB of memory. */
const MOST_SPLATS = 3_000_000;
/** Pixels: a tile whose error looks smaller is not replaced. */
const ERROR = 16;
const MOST_AT_A_TIME = 2;
/** Times the size of the scene. */
const NEAR = 4;

export class TilesetStream {
  private readonly tileset: TilesetFetch;
  private readonly limits: Limits = { ...LIMITS, slots: 2 * MOST_SPLATS };
  private readonly contents = new Map<Tile, Content>();
  private root: Tile | null = null;
  /** What the page takes for the origin, in the scene. */
  private base: Point = [0, 0, 0];
  private wanted: Tile[] = [];
  /** Tiles whose files of tiles are wanted. */
  private unread: Tile[] = [];
  private readonly loading = new Set<Tile>();
  /** Files that cannot be read, of contents or of tiles, and why. The others go on. */
  private readonly failures = new Map<Tile, FetchError>();
  private shown = "";
  private parts = 0;
  private view: EyeAndPlanes | null = null;
  private isOpen = false;
  private readonly bounds = new BoundsWatch();
  private hasBounds = false;
  /** The overview is there: files for what is looked at come now. */
  private hasOverview = false;
  private isAhead = false;
  private isClosed = false;
  /** Nothing goes on: the connection is lost, or the overview cannot be read. */
  private hasFailed = false;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private readonly abort = new AbortController();

  constructor(
    private readonly source: string,
    private wants: Wants,
    private readonly maxTextureSize: number,
    private readonly post: Post,
  ) {
    this.tileset = new TilesetFetch(source, {
      cache: "no-store",
      fetch: originFetch,
      signal: this.abort.signal,
      onFailure: () => this.later(),
    });
    void this.open();
  }

  want(wants: Wants): void {
    this.wants = wants;
    for (const content of this.contents.values()) content.want(wants);
    this.choose();
  }

  look(view: EyeAndPlanes): void {
    this.view = view;
    this.choose();
  }

  /** Goes on after a failure. */
  retry(): void {
    this.hasFailed = false;
    this.failures.clear();
    for (const content of this.contents.values()) content.error = null;
    if (this.root === null) void this.open();
    else this.choose();
  }

  /** There is no looking back at a tileset. */
  scrub(_bytes: number | null): void {}

  rewrite(): void {
    this.shown = "";
    for (const content of this.contents.values()) content.rewrite();
    this.later();
  }

  drawn(): void {
    this.isAhead = false;
    this.later();
  }

  close(): void {
    this.isClosed = true;
    this.abort.abort();
    clearTimeout(this.timer);
    for (const content of this.contents.values()) content.stop();
  }

  private async open(): Promise<void> {
    try {
      this.root = await this.tileset.open();
      await this.tileset.load(this.root);
      this.base = baseOf(this.root);
      this.choose();
    } catch (error) {
      this.root = null;
      this.fail(error);
    }
  }

  /** Decides which files are wanted, and begins to fetch them. */
  private choose(): void {
    const { root } = this;
    if (root === null || this.isClosed) return;
    const [x, y, z] = this.base;
    const view = this.view ?? { eye: [0, 0, 0], planes: [], pixels: 0 };
    const { tiles, load } = chooseTiles(
      root,
      {
        eye: [view.eye[0] + x, view.eye[1] + y, view.eye[2] + z],
        planes: view.planes.map(([a, b, c, d]) => [a, b, c, d - a * x - b * y - c * z]),
        pixels: view.pixels,
      },
      {
        splats: Math.min(this.wants.splats, MOST_SPLATS),
        error: this.hasBounds ? ERROR : Number.POSITIVE_INFINITY,
      },
    );
    const isOverview = root.url !== null && !this.contents.get(root)?.isDrawable;
    this.wanted = isOverview ? [root] : tiles;
    this.unread = isOverview ? [] : load;
    for (const tile of this.unread) void this.load(tile);
    this.forget();
    this.fetch();
    this.later();
  }

  private async load(tile: Tile): Promise<void> {
    if (this.loading.has(tile) || this.failures.has(tile)) return;
    this.loading.add(tile);
    try {
      await this.tileset.load(tile);
      this.loading.delete(tile);
      // What stood for it: it may have a file of its own now.
      this.contents.delete(tile);
      this.choose();
    } catch (error) {
      this.loading.delete(tile);
      this.note(tile, error);
      this.later();
    }
  }

  /** Starts what is wanted and not there, the most urgent first. */
  private fetch(): void {
    if (this.hasFailed) return;
    let running = 0;
    for (const content of this.contents.values()) if (content.isRunning) running++;
    for (const tile of this.wanted) {
      if (running >= MOST_AT_A_TIME) break;
      const known = this.contents.get(tile);
      if (known?.isDone || known?.isRunning || this.failures.has(tile)) continue;
      this.contentOf(tile).run();
      running++;
    }
    this.fillGaps();
  }

  /** Draws contents above files that cannot be read in their boxes. These overlap: no splat is drawn for two of them. */
  private fillGaps(): void {
    const gaps: { content: Content; above: Content }[] = [];
    for (const tile of this.failed()) {
      const above = this.drawnAbove(tile);
      if (above !== null) gaps.push({ content: this.contentOf(tile), above });
    }
    // The finest first, and then in an order that does not change with the view.
    gaps.sort((a, b) => depthOf(b.above.tile) - depthOf(a.above.tile) || a.content.part - b.content.part);
    const filled: Tile[] = [];
    for (const { content, above } of gaps) {
      const isHere = (tile: Tile) => isBelow(tile, above.tile);
      const others = this.wanted.filter((tile) => isHere(tile) && !this.failures.has(tile));
      const there = others.map((tile) => this.contents.get(tile)).filter((other) => other?.isDrawable);
      content.drawFrom(above, there as Content[], filled.filter(isHere));
      filled.push(content.tile);
    }
  }

  private contentOf(tile: Tile): Content {
    const known = this.contents.get(tile);
    if (known !== undefined) return known;
    const content = new Content(this.parts++, tile, this.placeOf(tile), this.wants, this.limits, () =>
      this.later(),
    );
    this.contents.set(tile, content);
    return content;
  }

  /** What is wanted, and cannot be read. */
  private failed(): Tile[] {
    return [...this.wanted, ...this.unread].filter((tile) => this.failures.has(tile));
  }

  /** The nearest content above a tile that came as a whole. */
  private drawnAbove(tile: Tile): Content | null {
    for (let at = tile.parent; at !== null; at = at.parent) {
      const content = this.contents.get(at);
      if (content?.isDrawable && !this.failures.has(at)) return content;
    }
    return null;
  }

  /** Notes that a file cannot be read. A lost connection concerns all, and so does the overview. */
  private note(tile: Tile, error: unknown): void {
    const isOfFile = error instanceof FetchError && (error.kind !== "lost" || error.status !== 0);
    if (isOfFile && tile !== this.root) this.failures.set(tile, error);
    else this.fail(error);
  }

  /** Forgets files that are neither wanted nor above what is wanted, nor drawn until that is there. */
  private forget(): void {
    const kept = new Set<Tile>(this.toDraw());
    for (const tile of [...this.wanted, ...this.unread]) {
      for (let at: Tile | null = tile; at !== null; at = at.parent) kept.add(at);
    }
    for (const [tile, content] of this.contents) {
      if (kept.has(tile)) continue;
      content.stop();
      this.contents.delete(tile);
    }
  }

  private placeOf({ origin }: Tile): [number, number, number] {
    return [0, 1, 2].map((a) => origin[a] - this.base[a]) as [number, number, number];
  }

  private toDraw(): Tile[] {
    const { root } = this;
    return tilesToDraw([...this.wanted, ...this.unread], (tile) => {
      const content = this.contents.get(tile);
      if (content === undefined) return false;
      // The overview is drawn while it comes: nothing is there before it.
      return content.isDrawable || (tile === root && content.splats > 0);
    });
  }

  private later(): void {
    if (this.isClosed) return;
    this.timer ??= setTimeout(() => {
      this.timer = undefined;
      try {
        this.flush();
      } catch (error) {
        this.close();
        this.post({ kind: "failed", failure: "internal", message: String(error) });
      }
    }, 40);
  }

  private flush(): void {
    for (const [tile, { error }] of this.contents) {
      if (error !== null && !this.hasFailed && !this.failures.has(tile)) this.note(tile, error);
    }
    if (!this.isOpen) this.begin();
    const rootContent = this.root === null ? undefined : this.contents.get(this.root);
    if (!this.isAhead) {
      for (const content of this.contents.values()) this.send(content, content.news(this.maxTextureSize));
      this.show();
    }
    const scene = rootContent?.decoder.scene ?? null;
    const bounds = scene === null ? null : this.bounds.next(scene, rootContent?.isRunning === false);
    if (bounds !== null) {
      this.hasBounds = true;
      const place = this.placeOf(this.root as Tile);
      const middle = bounds.middle.map((x, a) => x + place[a]) as [number, number, number];
      this.post({ kind: "bounds", middle, radius: bounds.radius });
    }
    if (rootContent?.isDrawable && this.hasBounds && !this.hasOverview) {
      this.hasOverview = true;
      this.choose();
    }
    this.fetch();
    this.post({ kind: "progress", progress: this.progress() });
  }

  private begin(): void {
    const directory = this.root === null ? null : (this.contents.get(this.root)?.decoder.directory ?? null);
    if (directory === null) return;
    this.isOpen = true;
    const { header, metadata } = directory;
    this.post({
      kind: "opened",
      layout: null,
      info: {
        name: this.source,
        size: 0,
        splats: this.tileset.splats,
        levels: header.nLevels,
        tiles: this.tileset.files,
        shDegree: header.shDegree,
        up: UP_AXES[header.upAxis],
        title: metadata.get("title") ?? "",
        camera: null,
        canLookBack: false,
      },
    });
  }

  private send(content: Content, news: ReturnType<Content["news"]>): void {
    if (news === null || !this.isOpen) return;
    this.isAhead = true;
    const buffers = news.updates.map(({ data }) => data.buffer as ArrayBuffer);
    this.post(
      { kind: "part", part: content.part, at: [...content.place] as [number, number, number], ...news },
      buffers,
    );
  }

  private show(): void {
    if (!this.isOpen) return;
    const shown = this.toDraw().map((tile) => (this.contents.get(tile) as Content).part);
    const kept = [...this.contents.values()].map(({ part }) => part);
    const said = `${shown}/${kept}`;
    if (said === this.shown) return;
    this.shown = said;
    this.post({ kind: "parts", shown, kept });
  }

  private fail(error: unknown): void {
    if (this.isClosed) return;
    this.hasFailed = true;
    const failure = error instanceof FetchError ? error.kind : "internal";
    this.post({ kind: "failed", failure, message: error instanceof Error ? error.message : String(error) });
  }

  private progress(): Progress {
    const all = [...this.contents.values()];
    const sum = (of: (content: Content) => number) => all.reduce((n, content) => n + of(content), 0);
    const isThere = this.unread.length === 0 && this.wanted.every((tile) => this.contents.get(tile)?.isDone);
    const fault = all.map(({ decoder }) => decoder.fault).find((found) => found !== null) ?? null;
    const waiting = all.find(({ fetcher, isRunning }) => isRunning && fetcher.failure !== null);
    const isReading = this.root === null || this.loading.size > 0;
    const failure = waiting?.fetcher.failure ?? (isReading ? this.tileset.failure : null);
    const isLoading = all.some(({ isRunning }) => isRunning) || isReading;
    const drawn = this.toDraw().map((tile) => this.contents.get(tile) as Content);
    const first = this.root === null ? undefined : this.contents.get(this.root);
    const received = this.tileset.received + sum(({ fetcher }) => fetcher.received);
    return {
      received,
      fetched: received,
      size: this.tileset.received + sum(({ fetcher, tile }) => fetcher.size ?? tile.bytes),
      requests: this.tileset.requests + sum(({ fetcher }) => fetcher.requests),
      state: failure !== null ? "waiting" : isLoading ? "loading" : "stopped",
      isPaused: this.wants.isPaused,
      isDone: this.hasOverview && isThere,
      waitsFor: failure?.message ?? "",
      splats: drawn.reduce((n, { splats }) => n + splats, 0),
      packets: sum(({ decoder }) => decoder.progress?.packets ?? 0),
      packetsApplied: sum(({ decoder }) => decoder.progress?.applied ?? 0),
      level: first === undefined ? -1 : levelOf(first.decoder),
      digests: {
        rows: sum(({ decoder }) => decoder.digests?.rows ?? 0),
        checked: sum(({ decoder }) => decoder.digests?.checked ?? 0),
        wrong: sum(({ decoder }) => decoder.digests?.wrong ?? 0),
      },
      fault: fault === null ? "" : `${fault.code} at byte ${fault.offset}`,
      files: drawn.map(({ tile }) => (tile.url ?? "").split("/").pop() ?? ""),
      failedFiles: this.failed().map((tile) => ({
        name: this.nameOf(tile),
        message: this.failures.get(tile)?.message ?? "",
      })),
    };
  }

  /** The name of a file in the folder of the tileset. */
  private nameOf({ url, external }: Tile): string {
    const name = url ?? external ?? "";
    const folder = new URL(".", this.source).href;
    return decoded(name.startsWith(folder) ? name.slice(folder.length) : name);
  }
}

/** The origin of the scene; or that of the first tile, where the scene is so far off that float32 does not do. */
function baseOf({ origin, low, high }: Tile): Point {
  const size = Math.hypot(...[0, 1, 2].map((a) => high[a] - low[a]));
  return Math.hypot(...origin) <= NEAR * size ? [0, 0, 0] : origin;
}

function isBelow(tile: Tile, above: Tile): boolean {
  for (let at = tile.parent; at !== null; at = at.parent) if (at === above) return true;
  return false;
}

function depthOf(tile: Tile): number {
  let depth = 0;
  for (let at = tile.parent; at !== null; at = at.parent) depth++;
  return depth;
}

/** Whether an address is that of a tileset. */
export function isTileset(source: string | File): boolean {
  return typeof source === "string" && URL.canParse(source) && /\.json$/i.test(new URL(source).pathname);
}
