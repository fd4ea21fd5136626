/** When the packets of a file are examined (spec 6.4). */

import { NO_BYTES } from "./channelBlock.js";
import { StreamError } from "./faults.js";
import { CORE, N_COMPONENTS, PALETTE, PICKS } from "./model.js";
import type { Scene } from "./scene.js";
import type { Verifier } from "./verifier.js";

const MISSING = 0;
const COMPLETE = 1;
const APPLIED = 2;
const FAULTY = 3;

/** Applies packets as soon as they are complete and do not wait. */
export class Scheduler {
  /** The fault of the first packet in file order, among those examined. */
  firstFault: StreamError | null = null;
  /** Packets that were applied, and all of the cut. */
  nApplied = 0;
  readonly nPackets: number;
  private firstFaulty = Number.POSITIVE_INFINITY;
  /** No packet of the cut before this one is missing. */
  private nPresent = 0;
  private readonly status: Uint8Array;
  /** Bytes of packets that are complete and wait. */
  private readonly held = new Map<number, Uint8Array>();
  /** The next packet of each chain. */
  private readonly next: Int32Array;
  /** Chains of picks that wait for the palette, by the last packet of it that they need. */
  private readonly waiting = new Map<number, Set<number>>();

  constructor(
    private readonly scene: Scene,
    private readonly verifier: Verifier | null,
  ) {
    const { packets } = scene.directory;
    this.status = new Uint8Array(packets.length);
    this.next = packets.first.slice();
    let n = 0;
    for (let i = 0; i < packets.length; i++) {
      if (!this.isWanted(i)) continue;
      n++;
      if (packets.size[i] === 0) this.status[i] = COMPLETE;
    }
    this.nPackets = n;
    for (let i = 0; i < packets.length; i++) {
      if (this.status[i] === COMPLETE) this.runFrom(packets.chainOf(i));
    }
  }

  /** Whether a packet is in the cut. */
  isWanted(i: number): boolean {
    return this.scene.directory.packets.label[i] <= this.scene.cut.level;
  }

  /** Whether bytes of a packet are of use: it is in the cut, and was not complete. */
  isMissing(i: number): boolean {
    return this.status[i] === MISSING && this.isWanted(i);
  }

  /** All bytes of packet `i` came. They are copied if they are kept: `isOwn` says that it need not be. */
  complete(i: number, bytes: Uint8Array, isOwn: boolean): void {
    this.status[i] = COMPLETE;
    this.held.set(i, bytes);
    this.runFrom(this.scene.directory.packets.chainOf(i));
    if (!isOwn && this.held.has(i)) this.held.set(i, bytes.slice());
  }

  /** The fault that R-6.4-4 reports while more bytes may come. */
  fault(): StreamError | null {
    if (this.firstFault === null) return null;
    const { status } = this;
    while (
      this.nPresent < this.firstFaulty &&
      !(status[this.nPresent] === MISSING && this.isWanted(this.nPresent))
    ) {
      this.nPresent++;
    }
    return this.nPresent >= this.firstFaulty ? this.firstFault : null;
  }

  /** Examines what it can of a chain, and of the chains that waited for it. */
  private runFrom(chain: number): void {
    const from = this.next[chain];
    if (!this.run(chain)) return;
    if (chain === PALETTE && this.scene.directory.header.hasPalette) this.wake(from);
    if (chain % N_COMPONENTS !== CORE) return;
    for (let component = 1; component <= PICKS; component++) this.run(chain + component);
  }

  /** Runs the picks that waited for packet `from` of the palette, or for one behind it that was applied. */
  private wake(from: number): void {
    const { next } = this.scene.directory.packets;
    for (let p = from; p >= 0 && this.status[p] === APPLIED; p = next[p]) {
      const chains = this.waiting.get(p);
      this.waiting.delete(p);
      for (const chain of chains ?? []) this.run(chain);
    }
  }

  /** Applies the packets of one chain until one is missing, waits, or has a fault. Whether any was applied. */
  private run(chain: number): boolean {
    const { packets } = this.scene.directory;
    const before = this.nApplied;
    for (let i = this.next[chain]; i >= 0 && this.status[i] === COMPLETE && !this.waits(i, chain); ) {
      if (!this.examine(i)) {
        this.next[chain] = -1;
        break;
      }
      i = packets.next[i];
      this.next[chain] = i;
    }
    return this.nApplied > before;
  }

  /** Whether a packet that is next in its chain waits for core or for the palette. */
  private waits(i: number, chain: number): boolean {
    const { packets } = this.scene.directory;
    const component = packets.component[i];
    if (component === CORE || component === PALETTE) return false;
    if (this.status[packets.core[i]] !== APPLIED) return true;
    if (component !== PICKS) return false;
    const last = packets.palette[i];
    if (last < 0 || this.status[last] === APPLIED) return false;
    const chains = this.waiting.get(last) ?? new Set();
    this.waiting.set(last, chains.add(chain));
    return true;
  }

  /** Applies packet `i`. False if it has a fault. */
  private examine(i: number): boolean {
    const bytes = this.held.get(i) ?? NO_BYTES;
    this.held.delete(i);
    try {
      this.scene.apply(i, bytes);
    } catch (error) {
      if (!(error instanceof StreamError)) throw error;
      this.status[i] = FAULTY;
      if (i < this.firstFaulty) {
        this.firstFaulty = i;
        this.firstFault = error;
      }
      return false;
    }
    this.status[i] = APPLIED;
    this.nApplied++;
    this.verifier?.check(this.scene, i);
    return true;
  }
}
