/** The dump of a cut (spec 7.7). */

import { bytesOf } from "./bytes.js";
import { channelCount } from "./model.js";
import type { Scene } from "./scene.js";
import { ShownChannels } from "./shown.js";

const HEADER_SIZE = 16;
const TILE_SIZE = 28;

/** The dump piece by piece. A piece is valid until the next one is asked for. */
export function* dumpPieces(scene: Scene): Generator<Uint8Array> {
  const { header, tiles } = scene.directory;
  const head = new Uint8Array(HEADER_SIZE);
  head.set([0x45, 0x56, 0x47, 0x44, 1, header.shDegree]);
  head.set(new Uint8Array(header.gridExponents.buffer, header.gridExponents.byteOffset, 5), 6);
  new DataView(head.buffer).setUint32(12, header.nTiles, true);
  yield head;

  const shown = new ShownChannels(scene);
  const nChannels = channelCount(header.shDegree);
  const row = new DataView(new ArrayBuffer(TILE_SIZE));
  for (let t = 0; t < header.nTiles; t++) {
    const tile = scene.tile(t);
    for (let axis = 0; axis < 3; axis++) {
      row.setBigInt64(8 * axis, BigInt(tiles.origin[3 * t + axis]), true);
    }
    row.setUint32(24, tile.nSlots, true);
    yield new Uint8Array(row.buffer);
    if (tile.nSlots === 0) continue;
    yield tile.liveSlots();
    for (let channel = 0; channel < nChannels; channel++) yield bytesOf(shown.read(t, channel));
  }
}

/** The size of the dump in bytes. */
export function dumpSize(scene: Scene): number {
  const { header } = scene.directory;
  const perSlot = 1 + 4 * channelCount(header.shDegree);
  let size = HEADER_SIZE;
  for (let t = 0; t < header.nTiles; t++) size += TILE_SIZE + perSlot * scene.tile(t).nSlots;
  return size;
}

/** The dump in one piece. */
export function dump(scene: Scene): Uint8Array {
  const bytes = new Uint8Array(dumpSize(scene));
  let at = 0;
  for (const piece of dumpPieces(scene)) {
    bytes.set(piece, at);
    at += piece.length;
  }
  return bytes;
}
