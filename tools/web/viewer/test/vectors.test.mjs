/**
 * Vectors of the conformance suite in a worker of a real browser. Every tenth run of a family, or all of them:
 * VECTORS=all npm test --workspace viewer
 */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { test } from "node:test";
import { build } from "esbuild";
import { fileURLToPath } from "node:url";
import { findChromium, launch } from "./browser.mjs";

const FOLDER = new URL("../../../../conformance/vectors/", import.meta.url);
const EVERY = process.env.VECTORS === "all" ? 1 : 10;
const skip = findChromium() === null ? "no Chromium: apt-get install chromium, or CHROMIUM=..." : false;

/** Vectors with the runs that are asked: the first of each family, and every `EVERY`th behind it. */
async function chosen() {
  const { vectors } = JSON.parse(await readFile(new URL("manifest.json", FOLDER), "utf8"));
  const counts = new Map();
  const isChosen = (family) => {
    const n = counts.get(family) ?? 0;
    counts.set(family, n + 1);
    return n % EVERY === 0;
  };
  return vectors
    .map(({ file, family, runs }) => ({ file, family, runs: runs.filter(() => isChosen(family)) }))
    .filter(({ runs }) => runs.length > 0);
}

/** A server of the worker and of the vectors. */
async function serve() {
  const entry = fileURLToPath(new URL("vectorWorker.mjs", import.meta.url));
  const options = { entryPoints: [entry], bundle: true, format: "iife", target: "es2022", write: false };
  const { outputFiles } = await build(options);
  const server = createServer(async ({ url }, response) => {
    if (url === "/") return response.writeHead(200, { "Content-Type": "text/html" }).end("<!doctype html>");
    if (url === "/worker.js") {
      return response.writeHead(200, { "Content-Type": "text/javascript" }).end(outputFiles[0].contents);
    }
    const bytes = await readFile(new URL(`.${url}`, FOLDER)).catch(() => null);
    response.writeHead(bytes === null ? 404 : 200).end(bytes);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return { server, url: `http://127.0.0.1:${server.address().port}/` };
}

/** The answers of a worker in a browser, by file. */
async function ask(vectors) {
  const { server, url } = await serve();
  const browser = await launch();
  try {
    const page = await browser.newPage();
    await page.goto(url);
    const answers = await page.evaluate(
      ({ vectors, url }) =>
        new Promise((resolve, reject) => {
          const found = [];
          const worker = new Worker("worker.js");
          worker.onerror = ({ message }) => reject(new Error(message));
          worker.onmessage = ({ data }) => (data === null ? resolve(found) : found.push(data));
          worker.postMessage({ vectors, url });
        }),
      { vectors, url },
    );
    return new Map(answers.map(({ file, answers }) => [file, answers]));
  } finally {
    await browser.close();
    server.close();
  }
}

test("the decoder answers vectors of all families in Chromium as the suite wants", { skip }, async (context) => {
  const vectors = await chosen();
  const families = new Set(vectors.map(({ family }) => family));
  assert.ok(families.size >= 22);
  const answers = await ask(vectors);
  let n = 0;
  for (const { file, runs } of vectors) {
    runs.forEach((run, i) => {
      const { exit, code = null, offset = null, dump, message } = answers.get(file)[i];
      const wanted = { exit: run.exit, code: run.code, dump: run.dump };
      assert.deepEqual({ exit, code, dump }, wanted, `${file} ${JSON.stringify(run)} ${message}`);
      if (run.offset !== null) assert.equal(offset, run.offset, file);
      n++;
    });
  }
  context.diagnostic(`${n} runs of ${vectors.length} vectors in ${families.size} families`);
});
