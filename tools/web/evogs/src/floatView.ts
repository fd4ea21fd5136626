/** The float view (spec 7.6): binary32 of (O + X) * 2^-G. */

import { withEngine } from "./compiled/engine.js";
import { compiledLoops } from "./compiled/floats.js";
import { N_CORE, channelCount, groupOf } from "./model.js";
import type { Scene } from "./scene.js";
import { ShownChannels, shownPicks } from "./shown.js";

/**
 * Values of a channel of tile `t` for the slots from .. to - 1, empty slots too, where all is 0 but for the
 * origin. Position is in scene units, scale a natural logarithm, opacity a logit (3.1).
 * They are written to `out` from 0 on, if it is given.
 */
export function slotFloats(
  scene: Scene,
  t: number,
  channel: number,
  from = 0,
  to = scene.tile(t).nSlots,
  out: Float32Array = new Float32Array(to - from),
  shown = new ShownChannels(scene),
): Float32Array {
  const { header, tiles } = scene.directory;
  const origin = channel < 3 ? tiles.origin[3 * t + channel] : 0;
  const unit = 2 ** -header.gridExponents[groupOf(channel)];
  const numbers = shown.read(t, channel, from, to);
  toFloats(numbers, origin, unit, out);
  return out;
}

/** The sum is below 2^53 and the product exact, so the only rounding is that to binary32. */
function toFloats(numbers: Int32Array, origin: number, unit: number, out: Float32Array): void {
  for (let i = 0; i < numbers.length; i++) out[i] = (origin + numbers[i]) * unit;
}

/** A channel of a tile: its numbers by slot, and the live slots; null if all are. */
export interface ChannelPart {
  numbers: Int32Array;
  slots: Int32Array | null;
  origin: number;
  unit: number;
}

/** What is done to all numbers of a float view: in plain loops here, or in those of the engine. */
export interface FloatLoops {
  /** (origin + number) * unit of the live slots of all tiles, `n` in all. */
  channel(parts: ChannelPart[], n: number): Float32Array;
  /** number * unit of the entries that were picked, from 1 on, of each channel of the palette; 0 for a pick of 0. */
  picked(channels: Int32Array[], unit: number, picks: Int32Array): Float32Array[];
}

const plainLoops: FloatLoops = {
  channel(parts, n) {
    const floats = new Float32Array(n);
    let from = 0;
    for (const { numbers, slots, origin, unit } of parts) {
      const out = floats.subarray(from);
      if (slots === null) toFloats(numbers, origin, unit, out);
      else for (let i = 0; i < slots.length; i++) out[i] = (origin + numbers[slots[i]]) * unit;
      from += (slots ?? numbers).length;
    }
    return floats;
  },

  picked(channels, unit, picks) {
    return channels.map((numbers) => {
      const table = new Float32Array(1 + numbers.length);
      toFloats(numbers, 0, unit, table.subarray(1));
      const out = new Float32Array(picks.length);
      for (let i = 0; i < picks.length; i++) out[i] = table[picks[i]];
      return out;
    });
  },
};

/** Values of all live splats, in the order of tiles and of slots: an array for each of the D channels. */
export function floatView(scene: Scene): Float32Array[] {
  return withEngine((engine) => viewBy(compiledLoops(engine), scene)) ?? viewBy(plainLoops, scene);
}

function viewBy(loops: FloatLoops, scene: Scene): Float32Array[] {
  const { header, tiles } = scene.directory;
  const live = Array.from({ length: header.nTiles }, (_, t) => liveNumbers(scene.tile(t).liveSlots()));
  // Each keeps what its tile shows, for one component after the other.
  const shown = live.map(() => new ShownChannels(scene));
  const nSplats = live.reduce((n, slots, t) => n + (slots?.length ?? scene.tile(t).nSlots), 0);
  const channelOf = (channel: number): Float32Array => {
    const unit = 2 ** -header.gridExponents[groupOf(channel)];
    const parts = live.map((slots, t) => {
      const origin = channel < 3 ? tiles.origin[3 * t + channel] : 0;
      return { numbers: shown[t].read(t, channel), slots, origin, unit };
    });
    return loops.channel(parts, nSplats);
  };
  const nOwn = header.hasPalette ? N_CORE : channelCount(header.shDegree);
  const view = Array.from({ length: nOwn }, (_, channel) => channelOf(channel));
  if (header.hasPalette) {
    const { palette } = scene;
    const channels = Array.from({ length: palette.nChannels }, (_, k) => palette.channel(k));
    const unit = 2 ** -header.gridExponents[groupOf(N_CORE)];
    view.push(...loops.picked(channels, unit, livePicks(scene, live, nSplats)));
  }
  return view;
}

/** What the live splats picked. */
function livePicks(scene: Scene, live: (Int32Array | null)[], nSplats: number): Int32Array {
  const all = new Int32Array(nSplats);
  let from = 0;
  live.forEach((slots, t) => {
    const picks = shownPicks(scene, t);
    all.set(slots === null ? picks : slots.map((slot) => picks[slot]), from);
    from += (slots ?? picks).length;
  });
  return all;
}

/** The live slots, or null if all are. */
function liveNumbers(live: Uint8Array): Int32Array | null {
  let n = 0;
  for (let u = 0; u < live.length; u++) n += live[u];
  if (n === live.length) return null;
  const slots = new Int32Array(n);
  for (let u = 0, i = 0; u < live.length; u++) if (live[u] === 1) slots[i++] = u;
  return slots;
}
