/** A file of a tileset that comes: it is fetched, decoded, and made texels. */

import { type Decoder, Decoder as PlainDecoder, type Limits, type Scene } from "evogs";
import { type Point, SceneFetch, type Tile, fileOrder } from "evogs-fetch";
import { type Layout, type TexelUpdate, TexelWriter, layoutOf } from "evogs-three/texels";
import type { Wants } from "./messages.js";

export class Content {
  readonly decoder: Decoder;
  readonly fetcher: SceneFetch;
  isDone = false;
  error: unknown = null;
  layout: Layout | null = null;
  private writer: TexelWriter | null = null;
  private isFresh = true;
  private running: Promise<void> | null = null;

  constructor(
    readonly part: number,
    readonly tile: Tile,
    /** Where its origin is drawn. */
    readonly at: Point,
    wants: Wants,
    limits: Limits,
    private readonly onNews: () => void,
  ) {
    this.decoder = new PlainDecoder({ limits, verify: true });
    this.fetcher = new SceneFetch(tile.url as string, this.decoder, {
      order: fileOrder({ shDegree: wants.shDegree }),
      bytesPerSecond: wants.bytesPerSecond,
      onBytes: onNews,
      onState: onNews,
    });
    if (wants.isPaused) this.fetcher.pause();
  }

  get isRunning(): boolean {
    return this.running !== null;
  }

  /** Splats that can be drawn. */
  get splats(): number {
    return this.decoder.scene?.splatCount() ?? 0;
  }

  want(wants: Wants): void {
    this.fetcher.bytesPerSecond = wants.bytesPerSecond;
    if (wants.isPaused) this.fetcher.pause();
    else this.fetcher.resume();
  }

  /** Fetches all that is wanted; `error` says why it ended before. */
  run(): void {
    this.error = null;
    this.running ??= this.fetcher
      .run()
      .then(
        () => {
          this.isDone = true;
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

  /** What is new for the renderer; null if nothing is. Throws a RangeError if it is too large for textures. */
  news(
    maxTextureSize: number,
  ): { updates: TexelUpdate[]; count: number; isFresh: boolean; layout: Layout } | null {
    const { scene } = this.decoder;
    if (scene === null) return null;
    this.writer ??= this.open(scene, maxTextureSize);
    const updates = this.writer.write(this.decoder.takeChanges(64));
    return updates.length === 0 && !this.isFresh ? null : this.taken(this.writer, updates);
  }

  /** All texels again. */
  rewritten(): ReturnType<Content["news"]> {
    const { scene } = this.decoder;
    if (scene === null || this.layout === null) return null;
    this.writer = new TexelWriter(scene, this.layout);
    scene.takeChanges();
    this.isFresh = true;
    return this.taken(this.writer, this.writer.writeAll());
  }

  stop(): void {
    this.fetcher.stop();
  }

  private open(scene: Scene, maxTextureSize: number): TexelWriter {
    this.layout = layoutOf(scene.directory, maxTextureSize);
    return new TexelWriter(scene, this.layout);
  }

  private taken(writer: TexelWriter, updates: TexelUpdate[]) {
    const { isFresh } = this;
    this.isFresh = false;
    return { updates, count: writer.count, isFresh, layout: writer.layout };
  }
}
