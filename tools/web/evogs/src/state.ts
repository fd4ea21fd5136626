/** Canonical states, and their digests (spec 7.7, 12.6). */

import { bytesOf } from "./bytes.js";
import { CORE, PALETTE, PICKS } from "./model.js";
import type { Scene } from "./scene.js";
import { Sha256 } from "./sha256.js";

/** The SHA-256 of the state of a component. Ask right after its step: `tile` is 0 for the palette. */
export function digestOf(scene: Scene, t: number, component: number): Uint8Array {
  const hash = new Sha256();
  const count = (n: number) => hash.update(bytesOf(new Int32Array([n])));
  if (component === PALETTE) {
    const { palette } = scene;
    count(palette.count);
    for (let k = 0; k < palette.nChannels; k++) hash.update(bytesOf(palette.channel(k)));
    return hash.digest();
  }
  const tile = scene.tile(t);
  if (component === PICKS) {
    const n = tile.nPicks;
    const numbers = new Int32Array(n);
    count(n);
    for (let k = 0; k < scene.palette.nChannels; k++) {
      const entries = scene.palette.channel(k);
      for (let u = 0; u < n; u++) numbers[u] = tile.picks[u] === 0 ? 0 : entries[tile.picks[u] - 1];
      hash.update(bytesOf(numbers));
    }
    return hash.digest();
  }
  const block = tile.block(component);
  count(block.count);
  if (component === CORE) {
    hash.update(tile.liveSlots());
    hash.update(bytesOf(tile.bornFrom.subarray(0, tile.nSlots)));
  }
  for (let k = 0; k < block.nChannels; k++) hash.update(bytesOf(block.channel(k)));
  return hash.digest();
}
