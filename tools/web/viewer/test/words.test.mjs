/** What is told of files that cannot be shown. */

import assert from "node:assert/strict";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath, pathToFileURL } from "node:url";
import { build } from "esbuild";
import { Decoder } from "evogs";

const EXAMPLE = new URL("../../../../spec/example.evogs", import.meta.url);
let folder;
let words;

before(async () => {
  folder = await mkdtemp(join(tmpdir(), "evogs-words-"));
  const outfile = join(folder, "words.mjs");
  const source = fileURLToPath(new URL("../src/words.ts", import.meta.url));
  await build({ entryPoints: [source], outfile, bundle: true, format: "esm", logLevel: "error" });
  words = await import(pathToFileURL(outfile));
});

after(() => rm(folder, { recursive: true, force: true }));

/** What is told of a fault that a decoder finds. */
function textOf(bytes, limits = {}) {
  const decoder = new Decoder({ limits });
  decoder.put(0, bytes);
  return words.failureText({ failure: "bad", message: `it cannot be shown: ${decoder.fault.message}` }, false)
    .text;
}

test("a scene that is too large is not called damaged", async () => {
  const bytes = new Uint8Array(await readFile(EXAMPLE));
  const slots = textOf(bytes, { slots: 1 });
  assert.match(slots, /^This scene has \d+ slots; the page shows at most 8,000,000\. Make a smaller stream/);
  const chunks = textOf(bytes, { chunks_size: 1 });
  assert.match(chunks, /^This scene is too large for the page \(chunks_size is \d+\)\. Make/);
});

test("a version that is not known is no damage", async () => {
  const bytes = new Uint8Array(await readFile(EXAMPLE));
  bytes[8] = 9;
  assert.match(textOf(bytes), /needs a newer viewer \(E_VERSION\)/);
  const { text } = words.failureText({ failure: "bad", message: "E_TIER at offset 9: n_tiles is 65" }, false);
  assert.equal(text, "The file is larger than its own tier allows (n_tiles is 65). Encode the scene again.");
});

test("a lost connection is told with what the server said last", () => {
  const text = (message, has) => words.failureText({ failure: "lost", message }, has).text;
  assert.equal(
    text("the server answers 503", true),
    "The server answers 503. Try again later. What arrived stays on screen.",
  );
  assert.match(text("no answer", false), /^The server does not answer\./);
  assert.equal(text("no answer", true), "The connection is lost. What arrived stays on screen.");
});

test("a tileset that lacks files is not verified", () => {
  const digests = { rows: 2, checked: 2, wrong: 0 };
  const file = { name: "tiles/1.evogs", message: "the server answers 404" };
  assert.equal(words.verified({ digests, failedFiles: [] }), "verified");
  assert.equal(words.verified({ digests, failedFiles: [file] }), "1 file missing");
  assert.equal(words.verified({ digests, failedFiles: [file, file] }), "2 files missing");
  assert.equal(words.verified({ digests: { ...digests, wrong: 1 }, failedFiles: [file] }), "1 digests differ");
  assert.equal(words.verified({ digests: { ...digests, checked: 1 } }), "1 of 2 digests");
});

test("names of addresses have no escapes", () => {
  assert.equal(words.nameOf("http://x.example/a/my%20scene.evogs?x"), "my scene.evogs");
  assert.equal(words.nameOf("http://x.example/100%.evogs"), "100%.evogs");
  assert.equal(words.nameOf("http://x.example/"), "x.example");
});
