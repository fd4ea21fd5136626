/** Runs the tests of all packages, as many files at the same time as there are cores. */

import { existsSync, readFileSync, readdirSync } from "node:fs";
import { availableParallelism } from "node:os";
import { run } from "node:test";
import { spec } from "node:test/reporters";
import { fileURLToPath } from "node:url";

/** Files that run a browser, and how long: the longest first, since one that begins late keeps the others waiting. */
const IN_BROWSERS = ["viewer", "devices", "loading", "views", "troubles", "spark", "vectors", "firefox"];

const files = testFiles();
const named = (name) => files.filter((path) => path.endsWith(`/${name}.test.mjs`));
const inBrowsers = IN_BROWSERS.flatMap(named);
// The first file makes the scenes for all others. Meanwhile those run that need none.
const first = named("pictures");
const others = files.filter((path) => !inBrowsers.includes(path) && !first.includes(path));

run({ files: [...first, ...others, ...inBrowsers], concurrency: availableParallelism() })
  .on("test:fail", () => {
    process.exitCode = 1;
  })
  .compose(new spec())
  .pipe(process.stdout);

function testFiles() {
  const here = (path) => fileURLToPath(new URL(path, import.meta.url));
  const { workspaces } = JSON.parse(readFileSync(here("package.json"), "utf8"));
  const folders = workspaces.map((name) => here(`${name}/test/`)).filter(existsSync);
  const of = (folder) => readdirSync(folder).filter((name) => name.endsWith(".test.mjs"));
  return folders.flatMap((folder) => of(folder).map((name) => folder + name));
}
