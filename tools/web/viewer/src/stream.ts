/** A scene that comes: it fetches, decodes, keeps what came, and says what to draw. Runs in the worker. */

import { CORE, Decoder, type Scene, viewpointOf } from "evogs";
import { type Budget, FetchError, SceneFetch, fileOrder, viewOrder } from "evogs-fetch";
import { type Layout, TexelWriter, layoutOf } from "evogs-three/texels";
import { blobFetch } from "./blobFetch.js";
import { BoundsWatch } from "./bounds.js";
import { LIMITS } from "./limits.js";
import type { EyeAndPlanes, FromWorker, Progress, SceneInfo, Wants } from "./messages.js";
import { originFetch } from "./originFetch.js";

export const UP_AXES: ([number, number, number] | null)[] = [
  null,
  [1, 0, 0],
  [-1, 0, 0],
  [0, 1, 0],
  [0, -1, 0],
  [0, 0, 1],
  [0, 0, -1],
];

export type Post = (message: FromWorker, transfer?: Transferable[]) => void;

export class SceneStream {
  private readonly decoder: Recorder;
  private readonly fetcher: SceneFetch;
  private writer: TexelWriter | null = null;
  /** The scene of a moment that is looked back at, instead of the last one. */
  private past: { decoder: Decoder; writer: TexelWriter; events: number } | null = null;
  private layout: Layout | null = null;
  private readonly bounds = new BoundsWatch();
  private view: EyeAndPlanes | null = null;
  private wants: Wants;
  /** The page has not drawn the texels of the last message. */
  private isAhead = false;
  private isFresh = true;
  private isDone = false;
  private isClosed = false;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly source: string | File,
    wants: Wants,
    private readonly maxTextureSize: number,
    private readonly post: Post,
  ) {
    this.wants = wants;
    this.decoder = new Recorder({ limits: LIMITS, verify: true });
    this.fetcher = new SceneFetch(typeof source === "string" ? source : "file:", this.decoder, {
      order: this.order(),
      bytesPerSecond: wants.bytesPerSecond,
      onBytes: () => this.later(),
      onState: () => this.later(),
      fetch: typeof source === "string" ? originFetch : blobFetch(source),
    });
    if (wants.isPaused) this.fetcher.pause();
    void this.run();
  }

  /** Wants more or less of the scene, faster or slower. */
  want(wants: Wants): void {
    const isOther = wants.splats !== this.wants.splats || wants.shDegree !== this.wants.shDegree;
    this.wants = wants;
    this.fetcher.bytesPerSecond = wants.bytesPerSecond;
    if (wants.isPaused) this.fetcher.pause();
    else this.fetcher.resume();
    if (isOther) this.reorder();
    this.later();
  }

  look(view: EyeAndPlanes): void {
    this.view = view;
    // With one tile the order does not depend on where one looks.
    if ((this.decoder.directory?.header.nTiles ?? 0) > 1) this.reorder();
  }

  /** Goes on after a failure. */
  retry(): void {
    if (this.fetcher.state === "stopped") void this.run();
  }

  /** Looks back at what the first `bytes` that came gave; or at all that came. */
  scrub(bytes: number | null): void {
    if (this.layout === null) return;
    if (bytes === null || bytes >= this.fetcher.received) {
      if (this.past === null) return;
      this.past = null;
      this.rewrite();
      return;
    }
    // Without its directory there is no scene.
    const events = Math.max(this.decoder.eventsWithin(bytes), this.decoder.directoryEvents);
    if (this.past === null || events < this.past.events) {
      const decoder = new Decoder({ limits: LIMITS });
      this.decoder.replay(decoder, 0, events);
      const scene = decoder.scene as Scene;
      this.past = { decoder, writer: new TexelWriter(scene, this.layout), events };
      this.isFresh = true;
    } else {
      this.decoder.replay(this.past.decoder, this.past.events, events);
      this.past.events = events;
    }
    this.later();
  }

  /** All texels again. */
  rewrite(): void {
    const { scene } = this.past?.decoder ?? this.decoder;
    if (scene === null || this.layout === null) return;
    const writer = new TexelWriter(scene, this.layout);
    scene.takeChanges();
    if (this.past !== null) this.past.writer = writer;
    else this.writer = writer;
    this.isFresh = true;
    this.sendTexels(writer, writer.writeAll());
  }

  /** The page drew the last texels. */
  drawn(): void {
    this.isAhead = false;
    this.later();
  }

  close(): void {
    this.isClosed = true;
    clearTimeout(this.timer);
    this.fetcher.stop();
  }

  private async run(): Promise<void> {
    this.isDone = false;
    try {
      await this.fetcher.run();
      this.isDone = true;
    } catch (error) {
      if (this.isClosed) return;
      // The page learns of the scene before it learns that it is not whole.
      this.flush();
      const failure = error instanceof FetchError ? error.kind : "internal";
      this.post({ kind: "failed", failure, message: error instanceof Error ? error.message : String(error) });
    }
    this.later();
  }

  private order() {
    const { splats, shDegree } = this.wants;
    const budget: Budget = { splats, shDegree };
    return this.view === null ? fileOrder(budget) : viewOrder(this.view, budget);
  }

  private reorder(): void {
    this.fetcher.want(this.order());
    if (this.fetcher.state === "stopped" && this.isDone) void this.run();
  }

  /** Sends what is new, soon. */
  private later(): void {
    if (this.isClosed) return;
    this.timer ??= setTimeout(() => {
      this.timer = undefined;
      this.flush();
    }, 40);
  }

  private flush(): void {
    if (this.isClosed) return;
    try {
      this.send();
    } catch (error) {
      this.close();
      this.post({ kind: "failed", failure: "internal", message: String(error) });
    }
  }

  private send(): void {
    const { scene } = this.decoder;
    if (scene !== null && this.layout === null) this.open(scene);
    if (scene !== null && !this.isAhead) {
      const shown = this.past?.decoder ?? this.decoder;
      const writer = this.past?.writer ?? this.writer;
      if (writer !== null) this.sendTexels(writer, writer.write(shown.takeChanges(64)));
    }
    if (scene !== null) {
      const bounds = this.bounds.next(scene, this.fetcher.state === "stopped");
      if (bounds !== null) this.post({ kind: "bounds", ...bounds });
    }
    this.post({ kind: "progress", progress: this.progress() });
  }

  private open(scene: Scene): void {
    this.layout = layoutOf(scene.directory, this.maxTextureSize);
    this.writer = new TexelWriter(scene, this.layout);
    this.post({ kind: "opened", info: this.info(scene), layout: this.layout });
  }

  private sendTexels(writer: TexelWriter, updates: ReturnType<TexelWriter["write"]>): void {
    if (updates.length === 0 && !this.isFresh) return;
    const buffers = updates.map(({ data }) => data.buffer as ArrayBuffer);
    const { isFresh } = this;
    this.isFresh = false;
    this.isAhead = true;
    this.post({ kind: "texels", updates, count: writer.count, isFresh, layout: writer.layout }, buffers);
  }

  private info({ directory }: Scene): SceneInfo {
    const { header, packets, metadata } = directory;
    const name = typeof this.source === "string" ? this.source : this.source.name;
    return {
      name,
      size: packets.end,
      splats: this.finalSplats(),
      levels: header.nLevels,
      tiles: header.nTiles,
      shDegree: header.shDegree,
      up: UP_AXES[header.upAxis],
      camera: viewpointOf(metadata),
      canLookBack: true,
      title: metadata.get("title") ?? "",
    };
  }

  /** Live splats when all is there. */
  private finalSplats(): number {
    const packets = this.decoder.directory?.packets;
    let n = 0;
    for (let i = 0; packets && i < packets.length; i++) {
      if (packets.component[i] === CORE) n += packets.nAdds[i] + packets.nSplits[i] - packets.nDrops[i];
    }
    return n;
  }

  private progress(): Progress {
    const { fetcher } = this;
    const shown = this.past?.decoder ?? this.decoder;
    const fault = this.decoder.fault;
    const { applied = 0, packets = 0 } = shown.progress ?? {};
    return {
      received: this.past === null ? fetcher.received : this.decoder.bytesOf(this.past.events),
      fetched: fetcher.received,
      size: fetcher.size,
      requests: fetcher.requests,
      state: fetcher.state,
      isPaused: fetcher.isPaused,
      isDone: this.isDone,
      waitsFor: fetcher.failure?.message ?? "",
      splats: shown.scene?.splatCount() ?? 0,
      packets,
      packetsApplied: applied,
      level: levelOf(shown),
      digests: this.decoder.digests,
      fault: fault === null ? "" : `${fault.code} at byte ${fault.offset}`,
    };
  }
}

/** The highest level of which all core packets were applied, or -1. */
export function levelOf({ scene }: Decoder): number {
  if (scene === null) return -1;
  const { packets } = scene.directory;
  let level = scene.directory.header.nLevels - 1;
  for (let i = 0; i < packets.length; i++) {
    const isMissing = packets.component[i] === CORE && packets.step[i] >= scene.tile(packets.tile[i]).steps[CORE];
    if (isMissing) level = Math.min(level, packets.label[i] - 1);
  }
  return level;
}

/** A decoder that keeps what it was given, so that it can be looked back at. */
class Recorder extends Decoder {
  /** Events after which the directory was there; 0 before. */
  directoryEvents = 0;
  private readonly events: { offset: number; bytes: Uint8Array }[] = [];
  /** Bytes that came before each event. */
  private readonly before = [0];

  override put(offset: number, bytes: Uint8Array): void {
    super.put(offset, bytes);
    if (bytes.length === 0) return;
    this.events.push({ offset, bytes: bytes.slice() });
    this.before.push(this.before[this.before.length - 1] + bytes.length);
    if (this.directory !== null && this.directoryEvents === 0) this.directoryEvents = this.events.length;
  }

  eventsWithin(bytes: number): number {
    let low = 0;
    let high = this.events.length;
    while (low < high) {
      const middle = (low + high + 1) >>> 1;
      if (this.before[middle] <= bytes) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  bytesOf(events: number): number {
    return this.before[events];
  }

  replay(decoder: Decoder, from: number, to: number): void {
    for (let i = from; i < Math.min(to, this.events.length); i++) {
      decoder.put(this.events[i].offset, this.events[i].bytes);
    }
  }
}
