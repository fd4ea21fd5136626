/** Sizes of what a page loads. */

import { readFile, readdir } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const PAGE = new URL("../viewer/dist/", import.meta.url);
const ENTRIES = { evogs: "../evogs/dist/index.js", "evogs-fetch": "../evogs-fetch/dist/index.js" };

const row = (bundle, bytes) => ({ bundle, minified: bytes.length, gzip: gzipSync(bytes, { level: 9 }).length });

export async function bundles() {
  const rows = [];
  for (const [name, path] of Object.entries(ENTRIES)) {
    const entryPoints = [new URL(path, import.meta.url).pathname];
    const options = { bundle: true, minify: true, format: "esm", target: "es2022", write: false };
    const external = name === "evogs" ? [] : ["evogs"];
    const { outputFiles } = await build({ ...options, entryPoints, external });
    rows.push(row(name, outputFiles[0].contents));
  }
  for (const name of (await readdir(PAGE)).filter((name) => name.endsWith(".js")).sort()) {
    rows.push(row(`page: ${name}`, await readFile(new URL(name, PAGE))));
  }
  return rows;
}
