/** The size of the bundle that a page would load. */

import { gzipSync } from "node:zlib";
import { build } from "esbuild";

async function sizes(label, plugins = []) {
  const { outputFiles } = await build({
    entryPoints: ["src/index.ts"],
    bundle: true,
    minify: true,
    format: "esm",
    target: "es2022",
    write: false,
    plugins,
  });
  const [{ contents }] = outputFiles;
  console.log(`${label}: ${contents.length} bytes, ${gzipSync(contents, { level: 9 }).length} after gzip`);
}

/** Leaves out the decompressor of src/zstd/. */
const withoutZstd = {
  name: "without-zstd",
  setup: (plugin) => plugin.onResolve({ filter: /zstd\// }, ({ path }) => ({ path, external: true })),
};

await sizes("all");
await sizes("without Zstandard", [withoutZstd]);
