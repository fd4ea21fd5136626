/** Decoding of a whole file (spec 6.1, 6.2). */

import { type Cut, cutByLevel } from "./cut.js";
import type { DecoderOptions } from "./decoder.js";
import { type Directory, parseDirectory } from "./directory.js";
import { StreamError, check } from "./faults.js";
import { PALETTE } from "./model.js";
import type { PacketTable } from "./packetTable.js";
import { Scene } from "./scene.js";
import { Verifier } from "./verifier.js";

/**
 * The scene of a whole file, or of its cut by `options.level`.
 * Throws a StreamError with the first fault of 6.1, and a CallerError if the stream has no such level.
 */
export function decode(file: Uint8Array, options: DecoderOptions = {}): Scene {
  const directory = parseDirectory(file, options.limits);
  const cut = cutByLevel(directory, options.level);
  const { packets, header } = directory;
  if (header.nTiles > 1) {
    try {
      return decodePackets(file, directory, cut, byTile(packets, header.nTiles), options);
    } catch (error) {
      // Another packet with a fault may come earlier in the file: that one is the first of 6.1.
      if (!(error instanceof StreamError)) throw error;
    }
  }
  return decodePackets(file, directory, cut, null, options);
}

/** The packets in an order in which a tile stays in the cache: the palette, then tile by tile. */
function byTile(packets: PacketTable, nTiles: number): Int32Array {
  const group = (i: number) => (packets.component[i] === PALETTE ? 0 : 1 + packets.tile[i]);
  const starts = new Int32Array(nTiles + 2);
  for (let i = 0; i < packets.length; i++) starts[group(i) + 1]++;
  for (let g = 0; g <= nTiles; g++) starts[g + 1] += starts[g];
  const order = new Int32Array(packets.length);
  for (let i = 0; i < packets.length; i++) order[starts[group(i)]++] = i;
  return order;
}

/** Applies the packets in an order, or in that of the file. Throws the first fault in that order. */
function decodePackets(
  file: Uint8Array,
  directory: Directory,
  cut: Cut,
  order: Int32Array | null,
  options: DecoderOptions,
): Scene {
  const { packets, digests } = directory;
  // Room for a whole tile is taken only if the file has the bytes that pay for it (R-5.6-7).
  const isWhole = file.length >= packets.end;
  const scene = new Scene(directory, cut, { atOnce: isWhole, tracksChanges: false });
  const verifier = options.verify && digests ? new Verifier(digests) : null;
  for (let k = 0; k < packets.length; k++) {
    const i = order === null ? k : order[k];
    if (packets.label[i] > cut.level) continue;
    const from = packets.offset[i];
    const to = from + packets.size[i];
    check(packets.size[i] === 0 || to <= file.length, "E_TRUNCATED", from);
    scene.apply(i, packets.size[i] === 0 ? file.subarray(0, 0) : file.subarray(from, to));
    verifier?.check(scene, i);
  }
  check(file.length <= packets.end, "E_TRAILING", packets.end);
  const fault = verifier?.fault();
  if (fault) throw fault;
  return scene;
}
