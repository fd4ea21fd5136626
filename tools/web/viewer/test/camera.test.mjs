/** The camera of the page takes the view of a stream, and turns around its target. */

import assert from "node:assert/strict";
import { mkdtemp, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath, pathToFileURL } from "node:url";
import { build } from "esbuild";

const source = fileURLToPath(new URL("../src/camera.ts", import.meta.url));
let folder;
let Camera;

before(async () => {
  folder = await mkdtemp(join(tmpdir(), "evogs-camera-"));
  const outfile = join(folder, "camera.mjs");
  await build({ entryPoints: [source], outfile, bundle: true, format: "esm", logLevel: "error" });
  ({ Camera } = await import(pathToFileURL(outfile)));
});

after(() => rm(folder, { recursive: true, force: true }));

const near = (found, expected, what) =>
  found.forEach((x, i) => assert.ok(Math.abs(x - expected[i]) < 1e-9, `${what}: ${found} is not ${expected}`));
const unit = (v) => v.map((x) => x / Math.hypot(...v));

test("the pose is that of the viewpoint, for any up", () => {
  const views = [
    { position: [3, 1, 2], target: [0, 0, 0.5], up: [0, 0, 1], fovY: 45 },
    { position: [3, 1, 2], target: [-1, 4, 0.5], up: [0, -1, 0], fovY: 80 },
    { position: [0.5, -2, 9], target: [1, 2, 3], up: [0.2, 0.7, -0.4], fovY: 10 },
  ];
  for (const view of views) {
    const camera = new Camera();
    camera.lookFrom(view, view.up);
    const { eye, rotation, fovY } = camera.pose;
    near(eye, view.position, "eye");
    near(rotation[2], unit(view.position.map((x, i) => x - view.target[i])), "back");
    // What is up in the picture is `up`, without its part along the axis.
    const along = view.up.reduce((sum, x, i) => sum + x * rotation[2][i], 0);
    near(rotation[1], unit(view.up.map((x, i) => x - along * rotation[2][i])), "up");
    assert.ok(Math.abs(fovY - (view.fovY * Math.PI) / 180) < 1e-12);
    camera.orbit(1, 0.1);
    near([Math.hypot(...camera.pose.eye.map((x, i) => x - view.target[i]))], [camera.distance], "distance");
  }
});
