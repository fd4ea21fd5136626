/** Builds the page: static files in dist/, and with `--install` in the Python package. */

import { cp, mkdir, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const dist = here("dist");
const installed = here("../../../evogs_codec/cli/viewer/page");

await rm(dist, { recursive: true, force: true });
await mkdir(dist, { recursive: true });
const options = {
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  outdir: dist,
  metafile: true,
  legalComments: "none",
  logLevel: "warning",
};
const page = { ...options, entryPoints: { viewer: here("src/main.ts") }, splitting: true, chunkNames: "[name]" };
// No module: a page from `file:` can have no worker of modules.
const worker = { ...options, entryPoints: { worker: here("src/worker.ts") }, format: "iife" };
const inputs = {};
for (const { metafile } of await Promise.all([build(page), build(worker)])) Object.assign(inputs, metafile.inputs);
await cp(here("page"), dist, { recursive: true });
await writeFile(`${dist}/LICENSES.txt`, await licences(inputs));

for (const name of (await readdir(dist)).sort()) {
  const bytes = await readFile(`${dist}/${name}`);
  console.log(`${name}: ${bytes.length} bytes, ${gzipSync(bytes, { level: 9 }).length} after gzip`);
}
if (process.argv.includes("--install")) {
  await rm(installed, { recursive: true, force: true });
  await cp(dist, installed, { recursive: true });
}

/** The licences of all packages that are in the bundle. */
async function licences(inputs) {
  const names = new Set();
  for (const path of Object.keys(inputs)) {
    const found = /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path);
    if (found && !found[1].startsWith("evogs")) names.add(found[1]);
  }
  // Spark holds its own dependencies already.
  for (const name of [...names]) {
    const { dependencies = {} } = JSON.parse(await readFile(here(`../node_modules/${name}/package.json`), "utf8"));
    for (const dependency of Object.keys(dependencies)) names.add(dependency);
  }
  const parts = [];
  for (const name of [...names].sort()) {
    const folder = here(`../node_modules/${name}`);
    const { version, license } = JSON.parse(await readFile(`${folder}/package.json`, "utf8"));
    const file = (await readdir(folder)).find((entry) => /^licen[cs]e/i.test(entry));
    const text = file ? await readFile(`${folder}/${file}`, "utf8") : "(its package has no text of the licence)";
    parts.push(`${name} ${version} (${license})\n\n${text.trim()}\n`);
  }
  return `This page contains these packages.\n\n${parts.join("\n----------\n\n")}`;
}
