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

/** As `toFloats`, of the numbers of some slots. */
function gatherFloats(
  numbers: Int32Array,
  slots: Int32Array,
  origin: number,
  unit: number,
  out: Float32Array,
): void {
  for (let i = 0; i < slots.length; i++) out[i] = (origin + numbers[slots[i]]) * unit;
}

/** Values of all live splats, in the order of tiles and of slots: an array for each of the D channels. */
export function floatView(scene: Scene): Float32Array[] {
  const { header, tiles } = scene.directory;
  const nSplats = scene.splatCount();
  const shown = new ShownChannels(scene);
  const view = Array.from({ length: channelCount(header.shDegree) }, () => new Float32Array(nSplats));
  const entries = header.hasPalette ? entryFloats(scene) : [];
  let from = 0;
  for (let t = 0; t < header.nTiles; t++) {
    const live = scene.tile(t).liveSlots();
    const slots = liveNumbers(live);
    const to = from + (slots?.length ?? live.length);
    const picks = header.hasPalette ? shownPicks(scene, t) : null;
    for (let channel = 0; channel < view.length; channel++) {
      const out = view[channel].subarray(from, to);
      if (picks !== null && channel >= N_CORE) {
        pick(entries[channel - N_CORE], picks, slots, out);
        continue;
      }
      const origin = channel < 3 ? tiles.origin[3 * t + channel] : 0;
      const unit = 2 ** -header.gridExponents[groupOf(channel)];
      const numbers = shown.read(t, channel);
      if (slots === null) toFloats(numbers, origin, unit, out);
      else gatherFloats(numbers, slots, origin, unit, out);
    }
    from = to;
  }
  return view;
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

/** Values of the entries of the palette, an array for each of its channels, behind a 0 for no entry. */
function entryFloats({ directory, palette }: Scene): Float32Array[] {
  const unit = 2 ** -directory.header.gridExponents[groupOf(N_CORE)];
  return Array.from({ length: palette.nChannels }, (_, k) => {
    const floats = new Float32Array(1 + palette.count);
    toFloats(palette.channel(k), 0, unit, floats.subarray(1));
    return floats;
  });
}

function pick(entries: Float32Array, picks: Int32Array, slots: Int32Array | null, out: Float32Array): void {
  if (slots === null) for (let i = 0; i < out.length; i++) out[i] = entries[picks[i]];
  else for (let i = 0; i < out.length; i++) out[i] = entries[picks[slots[i]]];
}
