/**
 * Compiles kernels/ to WebAssembly, and writes it as text to src/compiled/module.ts: a bundle is one file.
 * In base 16, of which gzip makes less than of base 64.
 */

import { readFile, writeFile } from "node:fs/promises";
import { argv } from "node:process";
import { fileURLToPath } from "node:url";
import asc from "assemblyscript/asc";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));

/** The bytes of the module, without the kernels that are named. */
export async function compile(without = []) {
  let bytes;
  const options = ["-O3", "--runtime", "stub", "--enable", "simd", "--use", "abort=", "--outFile", "out.wasm"];
  const { error, stderr } = await asc.main(["index.ts", "--baseDir", here("kernels"), ...options], {
    async readFile(name, folder) {
      const text = await readFile(`${folder}/${name}`, "utf8").catch(() => null);
      return name === "index.ts"
        ? without.reduce((left, kernel) => left.replace(`{ ${kernel} }`, "{}"), text)
        : text;
    },
    writeFile(_, contents) {
      bytes = contents;
    },
  });
  if (error) throw new Error(`${error.message}\n${stderr}`);
  return bytes;
}

/** The text of src/compiled/module.ts. */
export function moduleText(bytes) {
  const text = Buffer.from(bytes).toString("hex");
  return `/** What build.mjs made of kernels/, in base 16. */\n\nexport const MODULE =\n  "${text}";\n`;
}

if (argv[1] === here("build.mjs")) await writeFile(here("src/compiled/module.ts"), moduleText(await compile()));
