/** SH as shown (spec 7.5, 12.5): late slots show an ancestor, and empty slots show 0. */

import type { ChannelBlock } from "./channelBlock.js";
import { CORE, N_CORE, PICKS, channelsOf } from "./model.js";
import type { Scene } from "./scene.js";
import type { TileState } from "./tileState.js";

/** The slot whose SH each slot shows, or -1 where the SH are 0. `component` is a band or the picks. */
export function shownSlots(tile: TileState, component: number): Int32Array {
  const { nSlots, bornFrom, live } = tile;
  const n = tile.slotsOf(component);
  const sources = new Int32Array(nSlots);
  // A parent has a lower number, so its own source is known.
  for (let u = 0; u < nSlots; u++) {
    const parent = bornFrom[u];
    sources[u] = u < n ? u : parent < 0 ? -1 : sources[parent];
  }
  for (let u = 0; u < nSlots; u++) if (live[u] === 0) sources[u] = -1;
  return sources;
}

/** Channels of tiles as they are shown. It keeps the sources of one component of one tile. */
export class ShownChannels {
  private tile = -1;
  private component = -1;
  private sources: Int32Array | null = null;

  constructor(private readonly scene: Scene) {}

  /** Forget the sources: packets were applied. */
  reset(): void {
    this.tile = -1;
  }

  /**
   * The integers of a channel of tile `t` for the slots from .. to - 1; empty slots have 0.
   * Without a copy where they are stored as shown: then they are valid until the next step.
   */
  read(t: number, channel: number, from = 0, to = this.scene.tile(t).nSlots): Int32Array {
    const { scene } = this;
    const tile = scene.tile(t);
    if (channel < N_CORE) return tile.core.channel(channel).subarray(from, to);
    const component = this.componentOf(channel);
    const isLate = tile.isLate(component);
    const first = channelsOf(component, scene.directory.header.shDegree).first;
    if (component !== PICKS && !isLate && tile.steps[CORE] > 0)
      return tile
        .block(component)
        .channel(channel - first)
        .subarray(from, to);
    const sources = this.sourcesOf(t, component);
    const out = new Int32Array(to - from);
    if (component === PICKS) readPicked(tile, scene.palette, channel - first, sources, from, out);
    else if (tile.bands[component]) readLate(tile.block(component).channel(channel - first), sources, from, out);
    return out;
  }

  /** The picks that the slots from .. to - 1 of tile `t` show: 0, or the number of an entry from 1 on. */
  readPicks(t: number, from: number, to: number): Int32Array {
    const { picks } = this.scene.tile(t);
    const sources = this.sourcesOf(t, PICKS);
    if (sources === null) return picks.subarray(from, to);
    const out = new Int32Array(to - from);
    for (let i = 0; i < out.length; i++) if (sources[from + i] >= 0) out[i] = picks[sources[from + i]];
    return out;
  }

  /** The slots that the slots of tile `t` show, or null if all show themselves. */
  private sourcesOf(t: number, component: number): Int32Array | null {
    if (this.tile !== t || this.component !== component) {
      const tile = this.scene.tile(t);
      this.tile = t;
      this.component = component;
      this.sources = tile.isLate(component) ? shownSlots(tile, component) : null;
    }
    return this.sources;
  }

  private componentOf(channel: number): number {
    if (this.scene.directory.header.hasPalette) return PICKS;
    return channel < 23 ? 1 : channel < 38 ? 2 : 3;
  }
}

function readLate(x: Int32Array, sources: Int32Array | null, from: number, out: Int32Array): void {
  if (sources === null) return;
  for (let i = 0; i < out.length; i++) {
    const source = sources[from + i];
    if (source >= 0) out[i] = x[source];
  }
}

function readPicked(
  tile: TileState,
  palette: ChannelBlock,
  k: number,
  sources: Int32Array | null,
  from: number,
  out: Int32Array,
): void {
  const entries = palette.channel(k);
  const { picks } = tile;
  for (let i = 0; i < out.length; i++) {
    const source = sources === null ? from + i : sources[from + i];
    const pick = source < 0 ? 0 : picks[source];
    if (pick > 0) out[i] = entries[pick - 1];
  }
}

/** The pick that each slot of tile `t` shows: 0, or the number of an entry from 1 on. */
export function shownPicks(scene: Scene, t: number): Int32Array {
  const tile = scene.tile(t);
  if (!tile.isLate(PICKS)) return tile.picks.slice(0, tile.nSlots);
  const sources = shownSlots(tile, PICKS);
  for (let u = 0; u < sources.length; u++) sources[u] = sources[u] < 0 ? 0 : tile.picks[sources[u]];
  return sources;
}
