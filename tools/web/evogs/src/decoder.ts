/** The progressive decoder (spec 6.4): it is fed bytes, and asks for nothing. */

import { cutByLevel } from "./cut.js";
import { type Directory, parseChunks } from "./directory.js";
import { CallerError, StreamError } from "./faults.js";
import { HEADER_SIZE, type Header, checkSignature, parseHeader } from "./header.js";
import type { Limits } from "./limits.js";
import { RangeBuffer } from "./ranges.js";
import { type Change, Scene } from "./scene.js";
import { Scheduler } from "./scheduler.js";
import { Verifier } from "./verifier.js";

export interface DecoderOptions {
  /** The cut by this level (3.6). Without it, all packets. */
  level?: number;
  /** Limits of the caller by the names of 8.2 (8.3). Set some for files from unknown sources. */
  limits?: Limits;
  /** Whether digests are checked (R-5.7-4). It hashes up to 4096 bytes for each byte of the file. */
  verify?: boolean;
}

/** What is known when no more bytes come (6.4, "The end"). */
export interface Verdict {
  /** "nothing": header or chunks are not complete. "partial": packets are missing. */
  kind: "complete" | "partial" | "nothing" | "fault";
  fault: StreamError | null;
}

const UNKNOWN_SIZE = Number.MAX_SAFE_INTEGER;

/**
 * Decodes bytes of a file as they come, in order (`feed`) or as ranges in any order (`put`).
 * Between two calls `scene` is the state of the packets that are complete (R-6.4-1).
 * A fault ends nothing: what does not need the faulty packet is still decoded.
 */
export class Decoder {
  /** The header, once it is there: it says where the directory ends. */
  header: Header | null = null;
  /** Header and chunks, once they are there. */
  directory: Directory | null = null;
  /** The state, once the directory is there. */
  scene: Scene | null = null;
  private directoryFault: StreamError | null = null;
  private scheduler: Scheduler | null = null;
  private verifier: Verifier | null = null;
  /** Bytes that came before the directory was there. */
  private early: RangeBuffer | null = new RangeBuffer(UNKNOWN_SIZE);
  private prefix = 0;
  /** Packets of which some bytes came. */
  private readonly parts = new Map<number, RangeBuffer>();
  /** Where the last byte that came ends, and the next byte of `feed` begins. */
  private furthest = 0;
  private fed = 0;
  private isEnded = false;

  constructor(private readonly options: DecoderOptions = {}) {}

  /** Takes the next bytes of the file, in order from offset 0. They are not kept: copies are. */
  feed(bytes: Uint8Array): void {
    const at = this.fed;
    this.fed += bytes.length;
    this.put(at, bytes);
  }

  /**
   * Takes bytes that begin at `offset` of the file. Ranges may overlap and come again.
   * Throws a CallerError if the directory becomes complete and has no such level, or after `end`.
   */
  put(offset: number, bytes: Uint8Array): void {
    if (this.isEnded) throw new CallerError("bytes after the end");
    if (!Number.isSafeInteger(offset) || offset < 0) throw new CallerError(`offset ${offset}`);
    if (bytes.length === 0 || this.directoryFault) return;
    this.furthest = Math.max(this.furthest, offset + bytes.length);
    if (this.scheduler) this.putPackets(offset, bytes);
    else this.putEarly(offset, bytes);
  }

  /** The fault that is known by now, or null (R-6.4-4). It never goes away. */
  get fault(): StreamError | null {
    return this.directoryFault ?? this.scheduler?.fault() ?? null;
  }

  /** Packets of the cut, and how many of them were applied. Null before the directory is there. */
  get progress(): { applied: number; packets: number } | null {
    return this.scheduler && { applied: this.scheduler.nApplied, packets: this.scheduler.nPackets };
  }

  /** Digests of the file, those that were compared, and those that differ. Null without digests or `verify`. */
  get digests(): { rows: number; checked: number; wrong: number } | null {
    const rows = this.directory?.digests?.packet.length ?? 0;
    return this.verifier && { rows, checked: this.verifier.checked, wrong: this.verifier.wrong };
  }

  /** Slots that changed since the last call (see Scene.takeChanges). Numbers of the palette only grow. */
  takeChanges(maxGap = 0): Change[] {
    return this.scene?.takeChanges(maxGap) ?? [];
  }

  /** No more bytes come. The state stays as it is. */
  end(): Verdict {
    this.isEnded = true;
    const { scheduler, directory } = this;
    if (this.directoryFault) return { kind: "fault", fault: this.directoryFault };
    if (!scheduler || !directory) return { kind: "nothing", fault: null };
    let fault = scheduler.firstFault;
    if (!fault && this.furthest > directory.packets.end)
      fault = new StreamError("E_TRAILING", directory.packets.end);
    fault ??= this.verifier?.fault() ?? null;
    if (fault) return { kind: "fault", fault };
    return { kind: scheduler.nApplied === scheduler.nPackets ? "complete" : "partial", fault: null };
  }

  /** Bytes of header and chunks, and of what came with them. */
  private putEarly(offset: number, bytes: Uint8Array): void {
    const early = this.early as RangeBuffer;
    early.put(offset, bytes);
    if (offset > this.prefix) return;
    const before = this.prefix;
    this.prefix = early.gapAfter(before);
    try {
      this.readDirectory(early, before);
    } catch (error) {
      if (!(error instanceof StreamError)) throw error;
      this.directoryFault = error;
      this.early = null;
    }
  }

  private readDirectory(early: RangeBuffer, before: number): void {
    if (before < 8) checkSignature(early.copy(0, Math.min(8, this.prefix)));
    const { limits } = this.options;
    if (!this.header && this.prefix >= HEADER_SIZE) this.header = parseHeader(early.copy(0, HEADER_SIZE), limits);
    if (!this.header) return;
    const end = HEADER_SIZE + this.header.chunksSize;
    if (this.prefix < end) return;
    const directory = parseChunks(this.header, early.copy(HEADER_SIZE, end), limits);
    const { level, verify } = this.options;
    const cut = cutByLevel(directory, level);
    const scene = new Scene(directory, cut, { atOnce: false, tracksChanges: true });
    this.directory = directory;
    this.scene = scene;
    if (verify && directory.digests) this.verifier = new Verifier(directory.digests);
    this.scheduler = new Scheduler(scene, this.verifier);
    this.early = null;
    early.forEachRun((offset, run) => this.putPackets(offset, run));
  }

  /** Hands bytes to the packets that they belong to. */
  private putPackets(offset: number, bytes: Uint8Array): void {
    const { packets } = this.directory as Directory;
    const end = offset + bytes.length;
    for (let i = packets.at(offset); i < packets.length && packets.offset[i] < end; i++) {
      const start = packets.offset[i];
      const stop = start + packets.size[i];
      if (stop <= offset || packets.size[i] === 0) continue;
      const from = Math.max(start, offset);
      const to = Math.min(stop, end);
      this.putPart(i, from - start, bytes.subarray(from - offset, to - offset));
    }
  }

  private putPart(i: number, offset: number, bytes: Uint8Array): void {
    const scheduler = this.scheduler as Scheduler;
    if (!scheduler.isMissing(i)) return;
    const size = (this.directory as Directory).packets.size[i];
    if (bytes.length === size) {
      this.parts.delete(i);
      scheduler.complete(i, bytes, false);
      return;
    }
    const part = this.parts.get(i) ?? new RangeBuffer(size);
    part.put(offset, bytes);
    if (part.filled === size) {
      this.parts.delete(i);
      scheduler.complete(i, part.copy(0, size), true);
    } else {
      this.parts.set(i, part);
    }
  }
}
