/** The state of a scene, and what a packet does to it (spec 7, 12.5). */

import { ChannelBlock, NO_BYTES, NO_INTEGERS } from "./channelBlock.js";
import { crc32 } from "./crc32.js";
import type { Cut } from "./cut.js";
import type { Directory } from "./directory.js";
import type { SlotRange } from "./dirty.js";
import { check } from "./faults.js";
import type { StepCounts } from "./lists.js";
import { CORE, PALETTE, PICKS, channelsOf } from "./model.js";
import { type PacketLists, parsePacket } from "./packet.js";
import { applyPicks } from "./picks.js";
import { type StepRecords, planOf, readRecords } from "./records.js";
import { applyAdds, applyDrops, applyPsi, boxOf } from "./step.js";
import { TileState } from "./tileState.js";
import { Workspace } from "./workspace.js";

/** Slots of a tile whose numbers changed, for one component: core, an SH band, or picks. */
export interface Change {
  tile: number;
  component: number;
  ranges: SlotRange[];
}

export interface SceneOptions {
  /** Take all memory of a tile at its first packet. Right if the whole file is there. */
  atOnce: boolean;
  tracksChanges: boolean;
}

export class Scene {
  /** Channels from 14 on of the entries: entry e of the palette is at place e - 1. */
  readonly palette: ChannelBlock;
  private readonly tiles: (TileState | undefined)[];
  private readonly empty: TileState;
  private readonly workspace = new Workspace();
  /** Records of core packets that a packet of the cut still needs, and how many do. */
  private readonly records = new Map<number, { records: StepRecords; users: number }>();
  /** Tiles with changes that were not taken. */
  private readonly changed = new Set<number>();

  constructor(
    readonly directory: Directory,
    readonly cut: Cut,
    private readonly options: SceneOptions,
  ) {
    const { header } = directory;
    this.palette = new ChannelBlock(header.hasPalette ? channelsOf(PALETTE, header.shDegree).count : 0);
    this.tiles = new Array(header.nTiles);
    this.empty = new TileState(this.planOfTile(0));
  }

  /** The state of tile t. It is live: the next packet changes it. */
  tile(t: number): TileState {
    return this.tiles[t] ?? this.empty;
  }

  /** Live splats of all tiles. */
  splatCount(): number {
    let count = 0;
    for (const tile of this.tiles) {
      const live = tile?.liveSlots() ?? NO_BYTES;
      for (let u = 0; u < live.length; u++) count += live[u];
    }
    return count;
  }

  /**
   * Applies packet `i`, whose bytes are all there, and which waits for none.
   * Throws a StreamError at the packet, and changes nothing then (R-6.4-5).
   */
  apply(i: number, bytes: Uint8Array): void {
    const { header, packets } = this.directory;
    const component = packets.component[i];
    const offset = packets.offset[i];
    const counts = this.countsOf(component === PALETTE ? i : packets.core[i]);
    let lists: PacketLists | null = null;
    if (packets.size[i] > 0) {
      check(crc32(bytes) === packets.crc[i], "E_CRC", offset);
      lists = parsePacket(bytes, component, header.shDegree, counts, offset, this.workspace);
    }
    if (component === PALETTE) this.applyPalette(lists, counts, offset);
    else this.applyToTile(i, component, lists, counts, offset);
  }

  /** A tile without slots, for `setTile`. */
  newTile(t: number): TileState {
    return new TileState(this.planOfTile(t));
  }

  /** Takes a tile with all of its packets applied. */
  setTile(t: number, tile: TileState): void {
    this.tiles[t] = tile;
  }

  /** The slots that changed since the last call, in ranges. Gaps of up to `maxGap` slots are taken with them. */
  takeChanges(maxGap = 0): Change[] {
    const changes: Change[] = [];
    for (const t of [...this.changed].sort((a, b) => a - b)) {
      this.tile(t).dirty.forEach((dirty, component) => {
        const ranges = dirty?.take(maxGap) ?? [];
        if (ranges.length > 0) changes.push({ tile: t, component, ranges });
      });
    }
    this.changed.clear();
    return changes;
  }

  private planOfTile(t: number) {
    return {
      mostSlots: this.cut.slots[t] ?? 0,
      atOnce: this.options.atOnce,
      shDegree: this.directory.header.shDegree,
      tracksChanges: this.options.tracksChanges,
    };
  }

  private countsOf(row: number): StepCounts {
    const { nAdds, nSplits, nRefines, nDrops } = this.directory.packets;
    return { nAdds: nAdds[row], nSplits: nSplits[row], nRefines: nRefines[row], nDrops: nDrops[row] };
  }

  private applyPalette(lists: PacketLists | null, counts: StepCounts, offset: number): void {
    const { palette, workspace } = this;
    const { quantisers, header } = this.directory;
    const { first } = channelsOf(PALETTE, header.shDegree);
    const n = palette.count + counts.nAdds;
    palette.reserve(n, this.cut.entries, this.options.atOnce);
    const isGood = applyAdds(palette, first, palette.count, counts.nAdds, lists, quantisers, null, workspace);
    check(isGood, "E_RANGE", offset);
    palette.count = n;
  }

  private applyToTile(
    i: number,
    component: number,
    lists: PacketLists | null,
    counts: StepCounts,
    offset: number,
  ) {
    const { packets, alpha } = this.directory;
    const t = packets.tile[i];
    const tile = this.tiles[t] ?? this.newTile(t);
    const { nSlots } = tile;
    const records =
      component === CORE
        ? readRecords(lists, counts, packets.label[i], tile.live, nSlots, alpha, this.workspace, offset)
        : (this.records.get(packets.core[i])?.records as StepRecords);
    const from = tile.slotsOf(component);
    if (component === PICKS) {
      const isGood = applyPicks(tile, records, lists, packets.entriesFor(i), this.workspace);
      check(isGood, "E_INDEX", offset, "a pick");
    } else {
      check(this.applyChannels(t, tile, component, records, lists), "E_RANGE", offset);
    }
    this.tiles[t] = tile;
    tile.markChanged(component, records.slots, from);
    if (component === CORE) this.markLate(tile, records, from);
    this.countStep(tile, i, records);
    if (this.options.tracksChanges) this.changed.add(t);
  }

  /** Packet `i` was applied: its records are kept for those that need them, and let go behind the last. */
  private countStep(tile: TileState, i: number, records: StepRecords): void {
    const { component, core } = this.directory.packets;
    tile.steps[component[i]]++;
    if (component[i] === CORE) {
      const users = this.cut.users[i];
      if (users > 0) this.records.set(i, { records, users });
      return;
    }
    const kept = this.records.get(core[i]);
    if (kept && --kept.users === 0) this.records.delete(core[i]);
  }

  /** Core or a band: refines, splits and adds, then drops, which cannot fail. */
  private applyChannels(
    t: number,
    tile: TileState,
    component: number,
    records: StepRecords,
    lists: PacketLists | null,
  ) {
    const { alpha, quantisers, header } = this.directory;
    const { workspace } = this;
    const { first } = channelsOf(component, header.shDegree);
    const box = component === CORE ? boxOf(this.directory, t) : null;
    const plan = planOf(records, workspace);
    const block = tile.block(component);
    const addsAt = block.count + plan.nSplits;
    const end = addsAt + plan.nAdds;
    tile.reserve(component, end);
    const isGood =
      applyAdds(block, first, addsAt, plan.nAdds, lists, quantisers, box, workspace) &&
      applyPsi(block, first, plan, records, tile.bornFrom, lists, quantisers, alpha, box, workspace);
    if (!isGood) return false;
    if (component === CORE) {
      tile.addSlots(plan.parents, plan.nSplits, plan.nAdds);
      for (let d = 0; d < plan.nDrops; d++) tile.live[plan.drops[d]] = 0;
    }
    block.count = end;
    applyDrops(block, plan);
    return true;
  }

  /** A step of core also changes the SH that its slots show: new ones inherit, dropped ones show 0. */
  private markLate(tile: TileState, records: StepRecords, from: number): void {
    if (!this.options.tracksChanges) return;
    const { shDegree, hasPalette } = this.directory.header;
    const slots = records.counts.nDrops > 0 ? records.slots : NO_INTEGERS;
    if (hasPalette) tile.markChanged(PICKS, slots, from);
    else for (let band = 1; band <= shDegree; band++) tile.markChanged(band, slots, from);
  }
}
