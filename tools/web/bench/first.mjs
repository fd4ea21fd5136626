/** How many bytes bring the first splats, and each level: packets in the order of the file. */

import { readFileSync } from "node:fs";
import { CORE, Decoder } from "evogs";

const STEP = 256;

export function firstPictures(scenes) {
  return scenes.map(({ name, stream }) => {
    const bytes = readFileSync(stream);
    const decoder = new Decoder();
    const row = {
      scene: name,
      bytes: bytes.length,
      directory: Number.NaN,
      first: Number.NaN,
      "first %": Number.NaN,
    };
    let at = 0;
    while (!(decoder.scene?.splatCount() > 0)) {
      decoder.feed(bytes.subarray(at, at + STEP));
      at += STEP;
      if (decoder.directory !== null && Number.isNaN(row.directory)) {
        row.directory = decoder.directory.packets.offset[0];
      }
    }
    const { packets } = decoder.directory;
    let splats = 0;
    for (let i = 0; i < packets.length; i++) {
      if (packets.component[i] === CORE && packets.label[i] === 0) splats += packets.nAdds[i];
    }
    row.first = at;
    row["first %"] = (100 * at) / bytes.length;
    row["splats then"] = decoder.scene.splatCount();
    row["of level 0"] = splats;
    return row;
  });
}
