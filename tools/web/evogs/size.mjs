/** The size of the bundle that a page would load. */

import { gzipSync } from "node:zlib";
import { build } from "esbuild";
import { compile, moduleText } from "./build.mjs";

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

/** Leaves out both decompressors: that of src/zstd/, and that of kernels/. */
const withoutZstd = {
  name: "without-zstd",
  setup: (plugin) => {
    plugin.onResolve({ filter: /zstd\// }, ({ path }) => ({ path, external: true }));
    plugin.onLoad({ filter: /compiled\/module\.ts$/ }, async () => {
      return { contents: moduleText(await compile(["decompress"])), loader: "ts" };
    });
  },
};

await sizes("all");
await sizes("without Zstandard", [withoutZstd]);
