/** Decoding of a whole file (spec 6.1, 6.2). */

import { NO_BYTES } from "./channelBlock.js";
import { type Cut, cutByLevel } from "./cut.js";
import type { DecoderOptions } from "./decoder.js";
import { type Directory, parseDirectory } from "./directory.js";
import { withEngine } from "./compiled/engine.js";
import { FloatSink } from "./compiled/floats.js";
import { SceneSink } from "./compiled/scene.js";
import { decodeAll } from "./compiled/tile.js";
import { check } from "./faults.js";
import { floatView } from "./floatView.js";
import { CORE } from "./model.js";
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
  const scene = options.verify ? null : decodeByEngine(file, directory, cut);
  return scene ?? decodeInOrder(file, directory, cut, options.verify ?? false);
}

/**
 * Values of all live splats of a whole file, an array for each channel: `floatView(decode(file, options))`, in half
 * of the time, since the integers stay where they are decoded. It throws what `decode` throws.
 */
export function decodeFloats(file: Uint8Array, options: DecoderOptions = {}): Float32Array[] {
  const directory = parseDirectory(file, options.limits);
  const cut = cutByLevel(directory, options.level);
  const view = options.verify ? null : floatsByEngine(file, directory, cut);
  return view ?? floatView(decode(file, options));
}

/** The same; null if there is any fault, no WebAssembly, or SH that are late (7.5). */
export function floatsByEngine(file: Uint8Array, directory: Directory, cut: Cut): Float32Array[] | null {
  const { packets } = directory;
  if (file.length !== packets.end) return null;
  let n = 0;
  for (let i = 0; i < packets.length; i++) {
    const isMade = packets.component[i] === CORE && packets.label[i] <= cut.level;
    if (isMade) n += packets.nAdds[i] + packets.nSplits[i] - packets.nDrops[i];
  }
  return withEngine((engine) => {
    const sink = new FloatSink(engine, directory, n);
    decodeAll(engine, file, directory, cut, sink);
    return sink.end();
  });
}

/** The scene, tile by tile; null if there is any fault, or no WebAssembly. */
export function decodeByEngine(file: Uint8Array, directory: Directory, cut: Cut): Scene | null {
  if (file.length !== directory.packets.end) return null;
  return withEngine((engine) => {
    const scene = newScene(file, directory, cut);
    decodeAll(engine, file, directory, cut, new SceneSink(engine, scene));
    return scene;
  });
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
