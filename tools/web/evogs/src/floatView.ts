/** The float view (spec 7.6): binary32 of (O + X) * 2^-G. */

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

/**
 * Values of all live splats, in the order of tiles and of slots: an array for each of the D channels. Of a whole file
 * `decodeFloats` gives the same, in less time.
 */
export function floatView(scene: Scene): Float32Array[] {
  const { header, tiles } = scene.directory;
  const live = Array.from({ length: header.nTiles }, (_, t) => liveNumbers(scene.tile(t).liveSlots()));
  // Each keeps what its tile shows, for one component after the other.
  const shown = live.map(() => new ShownChannels(scene));
  const nSplats = scene.splatCount();
  const channelOf = (channel: number): Float32Array => {
    const unit = 2 ** -header.gridExponents[groupOf(channel)];
    const floats = new Float32Array(nSplats);
    let from = 0;
    live.forEach((slots, t) => {
      const origin = channel < 3 ? tiles.origin[3 * t + channel] : 0;
      const numbers = shown[t].read(t, channel);
      const out = floats.subarray(from, from + slots.length);
      if (slots.length === numbers.length) toFloats(numbers, origin, unit, out);
      else for (let i = 0; i < slots.length; i++) out[i] = (origin + numbers[slots[i]]) * unit;
      from += slots.length;
    });
    return floats;
  };
  const nOwn = header.hasPalette ? N_CORE : channelCount(header.shDegree);
  const view = Array.from({ length: nOwn }, (_, channel) => channelOf(channel));
  if (header.hasPalette) {
    const { palette } = scene;
    const unit = 2 ** -header.gridExponents[groupOf(N_CORE)];
    const picks = livePicks(scene, live, nSplats);
    for (let k = 0; k < palette.nChannels; k++) view.push(picked(palette.channel(k), unit, picks));
  }
  return view;
}

/** number * unit of the entries that were picked, from 1 on; 0 for a pick of 0. */
function picked(numbers: Int32Array, unit: number, picks: Int32Array): Float32Array {
  const table = new Float32Array(1 + numbers.length);
  toFloats(numbers, 0, unit, table.subarray(1));
  const out = new Float32Array(picks.length);
  for (let i = 0; i < picks.length; i++) out[i] = table[picks[i]];
  return out;
}

/** What the live splats picked. */
function livePicks(scene: Scene, live: Int32Array[], nSplats: number): Int32Array {
  const all = new Int32Array(nSplats);
  let from = 0;
  live.forEach((slots, t) => {
    const picks = shownPicks(scene, t);
    for (let i = 0; i < slots.length; i++) all[from + i] = picks[slots[i]];
    from += slots.length;
  });
  return all;
}

function liveNumbers(live: Uint8Array): Int32Array {
  const slots = new Int32Array(live.length);
  let n = 0;
  for (let u = 0; u < live.length; u++) if (live[u] === 1) slots[n++] = u;
  return slots.subarray(0, n);
}
