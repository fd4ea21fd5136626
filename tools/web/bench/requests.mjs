/** Requests and bytes of a whole scene over a connection of 10 Mbit/s. */

import { readFileSync } from "node:fs";
import { Decoder } from "evogs";
import { SceneFetch, fileOrder, viewOrder } from "evogs-fetch";
import { serve } from "../evogs-fetch/test/server.mjs";

const BYTES_PER_SECOND = 1.25e6;
/** What is seen from the middle along x, 90 degrees wide. */
const AHEAD = [
  [1, 1, 0, 0],
  [1, -1, 0, 0],
  [1, 0, 1, 0],
  [1, 0, -1, 0],
];

export async function requests(scenes) {
  const { name, stream } = scenes[scenes.length - 1];
  const bytes = readFileSync(stream);
  const rows = [];
  for (const [order, of] of Object.entries({
    file: fileOrder(),
    view: viewOrder({ eye: [0, 0, 0], planes: AHEAD }),
  })) {
    const server = await serve(bytes, { bytesPerSecond: BYTES_PER_SECOND });
    const decoder = new Decoder({ verify: true });
    const fetcher = new SceneFetch(server.url, decoder, { order: of });
    const start = performance.now();
    let first = Number.NaN;
    const timer = setInterval(() => {
      if (decoder.scene?.splatCount() > 0 && Number.isNaN(first)) first = (performance.now() - start) / 1000;
    }, 5);
    await fetcher.run();
    clearInterval(timer);
    const { rows: digests, checked, wrong } = decoder.digests;
    rows.push({
      scene: name,
      order,
      bytes: bytes.length,
      sent: server.log.sent,
      "sent twice": server.log.sent - fetcher.received,
      requests: server.log.requests.length,
      "first splats, s": first,
      "all, s": (performance.now() - start) / 1000,
      digests: `${checked} of ${digests}, ${wrong} wrong`,
    });
    await server.close();
  }
  return rows;
}
