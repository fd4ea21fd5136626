/** Decoding of a whole file (spec 6.1, 6.2). */

import { cutByLevel } from "./cut.js";
import type { DecoderOptions } from "./decoder.js";
import { parseDirectory } from "./directory.js";
import { check } from "./faults.js";
import { Scene } from "./scene.js";
import { Verifier } from "./verifier.js";

/**
 * The scene of a whole file, or of its cut by `options.level`.
 * Throws a StreamError with the first fault of 6.1, and a CallerError if the stream has no such level.
 */
export function decode(file: Uint8Array, options: DecoderOptions = {}): Scene {
  const directory = parseDirectory(file, options.limits);
  const { packets, digests } = directory;
  const cut = cutByLevel(directory, options.level);
  // Room for a whole tile is taken only if the file has the bytes that pay for it (R-5.6-7).
  const isWhole = file.length >= packets.end;
  const scene = new Scene(directory, cut, { atOnce: isWhole, tracksChanges: false });
  const verifier = options.verify && digests ? new Verifier(digests) : null;
  for (let i = 0; i < packets.length; i++) {
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
