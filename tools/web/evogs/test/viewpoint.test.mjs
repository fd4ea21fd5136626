/** The default camera of metadata: by the rules of the spec, as the reference codec reads it. */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { viewpointOf } from "../dist/index.js";

const RIGHT = { position: [0, -2, 0.5], target: [0, 0, 0.25], up: [0, 0, 1], fov_y: 45 };
const of = (value) =>
  viewpointOf(new Map([["camera", typeof value === "string" ? value : JSON.stringify(value)]]));

test("the example of the spec is read", async () => {
  const text = await readFile(new URL("../../../../spec/evogs.md", import.meta.url), "utf8");
  const [, example] = /^> Example\. `(\{.*\})`$/m.exec(text);
  assert.deepEqual(of(example), { position: [0, -2, 0.5], target: [0, 0, 0.25], up: [0, 0, 1], fovY: 45 });
});

test("up may be absent, and other members have no meaning", () => {
  const { up, ...rest } = RIGHT;
  assert.equal(of(rest).up, null);
  assert.deepEqual(of({ ...RIGHT, name: "front" }), of(RIGHT));
  assert.equal(viewpointOf(new Map()), null);
});

test("a malformed camera is none", () => {
  const changes = [
    { position: null },
    { position: [0, -2] },
    { position: [0, -2, "1"] },
    { position: [0, -2, true] },
    { position: [0, -2, 1e31] },
    { position: [0, 0, 0.25] },
    { target: { x: 1 } },
    { up: null },
    { up: [0, 0, 0] },
    { up: [0, 4, -0.5] },
    { fov_y: 0 },
    { fov_y: 180 },
    { fov_y: "45" },
    { fov_y: null },
  ];
  for (const change of changes) assert.equal(of({ ...RIGHT, ...change }), null, JSON.stringify(change));
  const texts = ["", "x", "[]", "7", "null", "[".repeat(60000), '{"position":', '{"fov_y": NaN}'];
  for (const text of texts) assert.equal(of(text), null, text.slice(0, 20));
});
