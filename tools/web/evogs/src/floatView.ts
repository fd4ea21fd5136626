/** The float view (spec 7.6): binary32 of (O + X) * 2^-G. */

import { channelCount, groupOf } from "./model.js";
import type { Scene } from "./scene.js";
import { ShownChannels } from "./shown.js";

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
  const numbers = shown.read(t, channel);
  // The sum is below 2^53 and the product exact, so the only rounding is that to binary32.
  for (let u = from; u < to; u++) out[u - from] = (origin + numbers[u]) * unit;
  return out;
}

/** Values of all live splats, in the order of tiles and of slots: an array for each of the D channels. */
export function floatView(scene: Scene): Float32Array[] {
  const { header } = scene.directory;
  const nSplats = scene.splatCount();
  const shown = new ShownChannels(scene);
  const view = Array.from({ length: channelCount(header.shDegree) }, () => new Float32Array(nSplats));
  let scratch = new Float32Array(0);
  let at = 0;
  for (let t = 0; t < header.nTiles; t++) {
    const live = scene.tile(t).liveSlots();
    const n = live.length;
    if (scratch.length < n) scratch = new Float32Array(n);
    let end = at;
    for (let channel = 0; channel < view.length; channel++) {
      slotFloats(scene, t, channel, 0, n, scratch, shown);
      const out = view[channel];
      end = at;
      for (let u = 0; u < n; u++) if (live[u] === 1) out[end++] = scratch[u];
    }
    at = end;
  }
  return view;
}
