/** The state of a tile (spec 7). */

import { ChannelBlock, NO_BYTES, NO_INTEGERS, grown } from "./channelBlock.js";
import { DirtySlots } from "./dirty.js";
import { CORE, N_CORE, PICKS, channelsOf } from "./model.js";

const NO_PARENT = -1;

/** What a scene tells each of its tiles. */
export interface TilePlan {
  /** Slots after all steps of the cut. */
  mostSlots: number;
  /** Whether room for all of them is taken at once. */
  atOnce: boolean;
  shDegree: number;
  /** Whether changes are kept for `takeChanges`. */
  tracksChanges: boolean;
}

export class TileState {
  /** Slots made so far. */
  nSlots = 0;
  /** 1 for each live slot. Longer than nSlots: see `liveSlots`. */
  live = NO_BYTES;
  /** The slot that each slot was split from, or -1. Longer than nSlots. */
  bornFrom = NO_INTEGERS;
  /** Channels 0 to 13. */
  readonly core = new ChannelBlock(N_CORE);
  /** The channels of SH bands 1 to 3 at places 1 to 3, once a packet of them was applied. */
  readonly bands: (ChannelBlock | null)[] = [null, null, null, null];
  /** The pick of each slot, and the slots after the last step of picks. Longer than nPicks. */
  picks = NO_INTEGERS;
  nPicks = 0;
  /** Steps that were applied of components 0 to 4. */
  readonly steps = [0, 0, 0, 0, 0];
  /** Changed slots of components 0 to 4. */
  readonly dirty: (DirtySlots | null)[] = [null, null, null, null, null];

  constructor(readonly plan: TilePlan) {}

  /** Liveness of the slots made so far, without a copy. */
  liveSlots(): Uint8Array {
    return this.live.subarray(0, this.nSlots);
  }

  /** The block of core or of a band, made if need be. */
  block(component: number): ChannelBlock {
    if (component === CORE) return this.core;
    const made = this.bands[component] ?? new ChannelBlock(channelsOf(component, this.plan.shDegree).count);
    this.bands[component] = made;
    return made;
  }

  /** Makes room for `n` slots in core or a band. */
  reserve(component: number, n: number): void {
    const { mostSlots, atOnce } = this.plan;
    this.block(component).reserve(n, mostSlots, atOnce);
    if (component !== CORE) return;
    this.live = grown(this.live, n, mostSlots, atOnce);
    this.bornFrom = grown(this.bornFrom, n, mostSlots, atOnce);
  }

  reservePicks(n: number): void {
    this.picks = grown(this.picks, n, this.plan.mostSlots, this.plan.atOnce);
  }

  /** Counts a step of core: second children of `parents` come first, then `nAdds` adds. */
  addSlots(parents: Int32Array, nSplits: number, nAdds: number): void {
    const from = this.nSlots;
    this.bornFrom.set(parents.subarray(0, nSplits), from);
    this.nSlots = from + nSplits + nAdds;
    this.bornFrom.fill(NO_PARENT, from + nSplits, this.nSlots);
    this.live.fill(1, from, this.nSlots);
    this.core.count = this.nSlots;
  }

  /** Whether a component has as many steps as core: then its slots show their own numbers. */
  isLate(component: number): boolean {
    return this.steps[component] < this.steps[CORE];
  }

  /** Slots that a component had after its last step. */
  slotsOf(component: number): number {
    if (component === PICKS) return this.nPicks;
    return component === CORE ? this.nSlots : (this.bands[component]?.count ?? 0);
  }

  /** Marks what a step of a component changed: the slots of its records, and all from `from` on. */
  markChanged(component: number, slots: Int32Array, from: number): void {
    if (!this.plan.tracksChanges) return;
    const dirty = this.dirty[component] ?? new DirtySlots();
    this.dirty[component] = dirty;
    dirty.mark(slots);
    dirty.markRange(from, this.nSlots);
  }
}
