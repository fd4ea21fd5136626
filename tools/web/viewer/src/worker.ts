/** The worker of the page: fetching and decoding hold no picture back. */

import type { FromWorker, ToWorker } from "./messages.js";
import { SceneStream } from "./stream.js";
import { TilesetStream, isTileset } from "./tilesetStream.js";

let stream: SceneStream | TilesetStream | null = null;
const post = (message: FromWorker, transfer: Transferable[] = []) =>
  (self as unknown as Worker).postMessage(message, transfer);

self.addEventListener("message", ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "open":
      stream?.close();
      stream = isTileset(data.source)
        ? new TilesetStream(data.source as string, data.wants, data.maxTextureSize, post)
        : new SceneStream(data.source, data.wants, data.maxTextureSize, post);
      break;
    case "want":
      stream?.want(data.wants);
      break;
    case "view":
      stream?.look(data.view);
      break;
    case "retry":
      stream?.retry();
      break;
    case "scrub":
      stream?.scrub(data.bytes);
      break;
    case "drawn":
      stream?.drawn();
      break;
    case "rewrite":
      stream?.rewrite();
      break;
  }
});
