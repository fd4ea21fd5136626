/** What the packages of this workspace hold when they are packed. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { fileURLToPath } from "node:url";

const WORKSPACE = new URL("../../", import.meta.url);
const { workspaces } = JSON.parse(readFileSync(new URL("package.json", WORKSPACE), "utf8"));

test("each package that can be published holds its licence", () => {
  const published = workspaces.filter(
    (name) => !JSON.parse(readFileSync(new URL(`${name}/package.json`, WORKSPACE), "utf8")).private,
  );
  assert.deepEqual(published, ["evogs", "evogs-fetch", "evogs-three"]);
  const licence = readFileSync(new URL("../../LICENSE", WORKSPACE), "utf8");
  const options = ["pack", "--dry-run", "--json", "--ignore-scripts"];
  const parameters = [...options, ...published.map((name) => `--workspace=${name}`)];
  const answer = execFileSync("npm", parameters, { cwd: fileURLToPath(WORKSPACE), encoding: "utf8" });
  for (const { name, files } of JSON.parse(answer)) {
    const paths = files.map(({ path }) => path);
    for (const path of ["LICENSE", "README.md", "package.json"])
      assert.ok(paths.includes(path), `${name}: ${path}`);
    assert.equal(readFileSync(new URL(`${name}/LICENSE`, WORKSPACE), "utf8"), licence, name);
  }
});
