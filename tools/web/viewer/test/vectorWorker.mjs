/** Runs of the conformance suite in a worker: each is answered with its verdict and the SHA-256 of its dump. */

import { Sha256, dumpPieces } from "evogs";
import { judge } from "../../evogs/bin/judge.mjs";

const hex = (bytes) => Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");

function answer(run, bytes) {
  const { scene, ...verdict } = judge(run, bytes);
  if (!scene) return { ...verdict, dump: null };
  const hash = new Sha256();
  for (const piece of dumpPieces(scene)) hash.update(piece);
  return { ...verdict, dump: hex(hash.digest()) };
}

self.addEventListener("message", async ({ data: { vectors, url } }) => {
  for (const { file, runs } of vectors) {
    const bytes = new Uint8Array(await (await fetch(url + file)).arrayBuffer());
    self.postMessage({
      file,
      answers: runs.map((run) => {
        try {
          return answer(run, bytes);
        } catch (error) {
          return { exit: 70, message: String(error) };
        }
      }),
    });
  }
  self.postMessage(null);
});
