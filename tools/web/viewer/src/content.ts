/** A file of a tileset that comes: it is fetched, decoded, and made texels. */

import { CORE, type Decoder, type Limits, Decoder as PlainDecoder, slotFloats } from "evogs";
import { type Point, SceneFetch, type Tile, fileOrder } from "evogs-fetch";
import { type Layout, TEXELS, type TexelUpdate, TexelWriter, layoutOf } from "evogs-three/texels";
import type { Wants } from "./messages.js";
import { originFetch } from "./originFetch.js";

/** A box along the axes. */
interface Box {
  low: readonly number[];
  high: readonly number[];
}

/** What is drawn while a file cannot be read: splats of a content above it, which others do not draw. */
interface StandIn {
  above: Content;
  others: readonly Content[];
  gaps: readonly Tile[];
  splats: number;
}

interface News {
  updates: TexelUpdate[];
  count: number;
  isFresh: boolean;
  layout: Layout;
}

export class Content {
  readonly decoder: Decoder;
  readonly fetcher: SceneFetch;
  /** All that is wanted is there. */
  isDone = false;
  error: unknown = null;
  private layout: Layout | null = null;
  private writer: TexelWriter | null = null;
  private isFresh = true;
  private running: Promise<void> | null = null;
  private shDegree: number;
  /** It was done once: it can be drawn while more is wanted of it. */
  private wasDone = false;
  private standIn: StandIn | null = null;
  private centres: Box | null = null;

  constructor(
    readonly part: number,
    readonly tile: Tile,
    private readonly at: Point,
    wants: Wants,
    limits: Limits,
    private readonly onNews: () => void,
  ) {
    this.shDegree = wants.shDegree;
    this.decoder = new PlainDecoder({ limits, verify: true });
    this.fetcher = new SceneFetch(tile.url ?? "", this.decoder, {
      order: fileOrder({ shDegree: wants.shDegree }),
      bytesPerSecond: wants.bytesPerSecond,
      onBytes: onNews,
      onState: onNews,
      fetch: originFetch,
    });
    if (wants.isPaused) this.fetcher.pause();
  }

  get isRunning(): boolean {
    return this.running !== null;
  }

  /** Whether it can take the place of what is above it. */
  get isDrawable(): boolean {
    return this.wasDone || this.standIn !== null;
  }

  /** Where the origin of what is drawn is drawn. */
  get place(): Point {
    return this.standIn?.above.at ?? this.at;
  }

  /** Splats that can be drawn. */
  get splats(): number {
    return this.standIn?.splats ?? this.decoder.scene?.splatCount() ?? 0;
  }

  /** Wants it faster or slower, or other SH degrees of it: then it is to be run again. */
  want(wants: Wants): void {
    this.fetcher.bytesPerSecond = wants.bytesPerSecond;
    if (wants.isPaused) this.fetcher.pause();
    else this.fetcher.resume();
    if (wants.shDegree === this.shDegree) return;
    this.shDegree = wants.shDegree;
    this.fetcher.want(fileOrder({ shDegree: wants.shDegree }));
    this.isDone = false;
  }

  /** Fetches all that is wanted; `error` says why it ended before. */
  run(): void {
    this.error = null;
    this.running ??= this.fetcher
      .run()
      .then(
        () => {
          this.isDone = true;
          this.wasDone = true;
          if (this.standIn === null) return;
          this.standIn = null;
          this.rewrite();
        },
        (error) => {
          this.error = error;
        },
      )
      .finally(() => {
        this.running = null;
        this.onNews();
      });
  }

  /**
   * Draws what a content above it has in the box of this tile until the file can be read; but not where others are,
   * nor in the boxes of other gaps, which are filled already.
   */
  drawFrom(above: Content, others: readonly Content[], gaps: readonly Tile[]): void {
    const old = this.standIn;
    const isSame = old?.above === above && areSame(old.others, others) && areSame(old.gaps, gaps);
    if (this.wasDone || isSame) return;
    this.standIn = { above, others, gaps, splats: old?.splats ?? 0 };
    this.rewrite();
  }

  /** What is new for the renderer; null if nothing is. Throws a RangeError if it is too large for textures. */
  news(maxTextureSize: number): News | null {
    if (this.standIn !== null) return this.isFresh ? this.newsOf(this.standIn, maxTextureSize) : null;
    const { scene } = this.decoder;
    if (scene === null) return null;
    this.layout ??= layoutOf(scene.directory, maxTextureSize);
    let updates: TexelUpdate[];
    if (this.writer === null) {
      this.writer = new TexelWriter(scene, this.layout);
      scene.takeChanges();
      updates = this.writer.writeAll();
    } else {
      updates = this.writer.write(this.decoder.takeChanges(64));
    }
    if (updates.length === 0 && !this.isFresh) return null;
    const { isFresh } = this;
    this.isFresh = false;
    return { updates, count: this.writer.count, isFresh, layout: this.layout };
  }

  /** All texels come again, with the next news. */
  rewrite(): void {
    this.writer = null;
    this.isFresh = true;
  }

  stop(): void {
    this.fetcher.stop();
  }

  /** All texels of a stand-in. */
  private newsOf(standIn: StandIn, maxTextureSize: number): News | null {
    const { scene } = standIn.above.decoder;
    if (scene === null) return null;
    const { origin } = standIn.above.tile;
    const own = moved(this.tile, this.tile.origin, origin);
    const taken = [
      ...standIn.others.map((other) => moved(other.centresBox(), other.tile.origin, origin)),
      ...standIn.gaps.map((gap) => moved(gap, gap.origin, origin)),
    ];
    const layout = layoutOf(scene.directory, maxTextureSize);
    const writer = new TexelWriter(scene, layout);
    const updates = writer.writeAll();
    standIn.splats = 0;
    for (const { texture, data } of updates) if (texture === CORE) standIn.splats += keepWithin(data, own, taken);
    this.isFresh = false;
    return { updates, count: writer.count, isFresh: true, layout };
  }

  /** The box of the centres of its splats: those of tiles beside one another do not overlap. */
  private centresBox(): Box {
    const { scene } = this.decoder;
    if (this.centres !== null || scene === null) return this.centres ?? this.tile;
    const low = [0, 0, 0].fill(Number.POSITIVE_INFINITY);
    const high = [0, 0, 0].fill(Number.NEGATIVE_INFINITY);
    for (let t = 0; t < scene.directory.header.nTiles; t++) {
      const live = scene.tile(t).liveSlots();
      for (let axis = 0; axis < 3; axis++) {
        const numbers = slotFloats(scene, t, axis);
        for (let u = 0; u < live.length; u++) {
          if (live[u] !== 1) continue;
          low[axis] = Math.min(low[axis], numbers[u]);
          high[axis] = Math.max(high[axis], numbers[u]);
        }
      }
    }
    this.centres = { low, high };
    return this.centres;
  }
}

function areSame<T>(some: readonly T[], others: readonly T[]): boolean {
  return some.length === others.length && some.every((one) => others.includes(one));
}

/** A box from another origin. */
function moved({ low, high }: Box, from: Point, to: Point): Box {
  const shift = (corner: readonly number[]) => corner.map((x, a) => x + from[a] - to[a]);
  return { low: shift(low), high: shift(high) };
}

/** Makes splats outside of a box, or in one that is taken, transparent in texels of `CORE`. The number of those left. */
function keepWithin(data: Uint32Array, own: Box, taken: readonly Box[]): number {
  const words = 4 * TEXELS[CORE];
  const floats = new Float32Array(data.buffer, data.byteOffset, data.length);
  let kept = 0;
  for (let at = 0; at < data.length; at += words) {
    const isIn = ({ low, high }: Box) => low.every((x, a) => x <= floats[at + a] && floats[at + a] <= high[a]);
    if (!isIn(own) || taken.some(isIn)) data.fill(0, at, at + words);
    // The word of opacity and a scale: 0 where there is no splat.
    else if (data[at + 3] !== 0) kept++;
  }
  return kept;
}
