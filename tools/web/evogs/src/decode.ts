/** Decoding of a whole file (spec 6.1, 6.2). */

import { NO_BYTES } from "./channelBlock.js";
import { type Cut, cutByLevel } from "./cut.js";
import type { DecoderOptions } from "./decoder.js";
import { type Directory, parseDirectory } from "./directory.js";
import { StreamError, check } from "./faults.js";
import { PALETTE } from "./model.js";
import type { PacketTable } from "./packetTable.js";
import { runFrom } from "./refineRun.js";
import { Scene } from "./scene.js";
import { Verifier } from "./verifier.js";

/**
 * The scene of a whole file, or of its cut by `options.level`.
 * Throws a StreamError with the first fault of 6.1, and a CallerError if the stream has no such level.
 */
export function decode(file: Uint8Array, options: DecoderOptions = {}): Scene {
  const directory = parseDirectory(file, options.limits);
  const cut = cutByLevel(directory, options.level);
  // Which fault is the first of 6.1, and digests, need the order of the file.
  if (!options.verify) {
    const scene = decodeByTile(file, directory, cut);
    if (scene !== null) return scene;
  }
  return decodeInOrder(file, directory, cut, options.verify ?? false);
}

function newScene(file: Uint8Array, directory: Directory, cut: Cut): Scene {
  // Room for a whole tile is taken only if the file has the bytes that pay for it (R-5.6-7).
  return new Scene(directory, cut, { atOnce: file.length >= directory.packets.end, tracksChanges: false });
}

/** Applies the packets in the order of the file. Throws the first fault. */
function decodeInOrder(file: Uint8Array, directory: Directory, cut: Cut, verify: boolean): Scene {
  const { packets, digests } = directory;
  const scene = newScene(file, directory, cut);
  const verifier = verify && digests ? new Verifier(digests) : null;
  for (let i = 0; i < packets.length; i++) {
    if (packets.label[i] > cut.level) continue;
    const from = packets.offset[i];
    const to = from + packets.size[i];
    check(packets.size[i] === 0 || to <= file.length, "E_TRUNCATED", from);
    scene.apply(i, packets.size[i] === 0 ? NO_BYTES : file.subarray(from, to));
    verifier?.check(scene, i);
  }
  check(file.length <= packets.end, "E_TRAILING", packets.end);
  const fault = verifier?.fault();
  if (fault) throw fault;
  return scene;
}

/** The same scene, in an order in which numbers stay in the cache. Null if there is any fault. */
function decodeByTile(file: Uint8Array, directory: Directory, cut: Cut): Scene | null {
  const { packets, header } = directory;
  if (file.length !== packets.end) return null;
  const scene = newScene(file, directory, cut);
  const bytesOf = (i: number) =>
    packets.size[i] === 0 ? NO_BYTES : file.subarray(packets.offset[i], packets.offset[i] + packets.size[i]);
  const isDone = new Uint8Array(packets.length);
  try {
    for (const i of byTile(packets, header.nTiles)) {
      if (packets.label[i] > cut.level || isDone[i] === 1) continue;
      const run = runFrom(packets, i, cut.level, isDone);
      if (run.length === 1) scene.apply(i, bytesOf(i));
      else scene.applyRun(run, run.map(bytesOf));
      for (const p of run) isDone[p] = 1;
    }
  } catch (error) {
    if (error instanceof StreamError) return null;
    throw error;
  }
  return scene;
}

/** The packets: those of the palette, then tile by tile. */
function byTile(packets: PacketTable, nTiles: number): Int32Array {
  const group = (i: number) => (packets.component[i] === PALETTE ? 0 : 1 + packets.tile[i]);
  const starts = new Int32Array(nTiles + 2);
  for (let i = 0; i < packets.length; i++) starts[group(i) + 1]++;
  for (let g = 0; g <= nTiles; g++) starts[g + 1] += starts[g];
  const order = new Int32Array(packets.length);
  for (let i = 0; i < packets.length; i++) order[starts[group(i)]++] = i;
  return order;
}
