/** What the page draws while a scene comes, beside the pictures of the rasterizer. */

import assert from "node:assert/strict";
import { picture, psnr, stateOf, until } from "./browser.mjs";
import { brightness, inBrowser, isDone, letThrough, open, page, scenes, server, setPose } from "./page.mjs";
import { references } from "./scenes.mjs";

/** dB; pictures of the same splats differ by less from one run to the next. */
const NOISE = 0.01;

// The more splats lie over each other, the more 8-bit blending rounds.
for (const [name, percents, least] of [
  ["sh3", [5, 10, 20, 50, 100], 42],
  ["sh1", [5, 10, 20, 50, 100], 42],
  ["five", [10, 20, 50, 100], 42],
  ["default", [5, 10, 20, 50, 100], 41],
]) {
  inBrowser(`pictures at ${percents.join(", ")} % of ${name} are those of the rasterizer`, async (context) => {
    const bytes = scenes[name];
    const sizes = percents.map((percent) => Math.floor((bytes.length * percent) / 100));
    const { pose, pictures } = references(name, sizes);
    server.bytesPerSecond = 100000;
    server.gate = 0;
    await open(`${name}.evogs`);
    await setPose(pose);
    const found = [];
    for (const [i, size] of sizes.entries()) {
      const shown = await letThrough(size);
      assert.equal((await stateOf(page)).progress.received, size);
      if (i === 0) assert.ok(brightness(shown) > 5, `there is something to see at ${percents[0]} %`);
      found.push(psnr(shown, pictures[i]));
    }
    context.diagnostic(`${name}: ${found.map((db) => db.toFixed(1)).join(", ")} dB at ${percents.join(", ")} %`);
    for (const db of found) assert.ok(db >= least, `${db} dB`);
    const { progress } = await until(page, isDone, "the end");
    assert.equal(progress.digests.checked, progress.digests.rows);
    assert.ok(progress.digests.rows > 0);
    assert.equal(progress.digests.wrong, 0);
    assert.equal(await page.textContent("#verified"), "verified");
  });
}

inBrowser("quality never falls over 20 snapshots", async (context) => {
  const bytes = scenes.default;
  const sizes = Array.from({ length: 20 }, (_, k) => Math.floor((bytes.length * (k + 1)) / 20));
  const { pose, pictures } = references("default", [bytes.length]);
  server.bytesPerSecond = 100000;
  server.gate = 0;
  await open("default.evogs");
  await setPose(pose);
  const found = [];
  for (const size of sizes) found.push(psnr(await letThrough(size), pictures[0]));
  context.diagnostic(`dB: ${found.map((db) => db.toFixed(2)).join(", ")}`);
  for (let k = 1; k < found.length; k++) assert.ok(found[k] >= found[k - 1] - NOISE, `snapshot ${k}: ${found}`);
  assert.ok(found[19] > found[0] + 20);
});

// Splits of level 1; and tiles that have no splat before, beside splits of others.
for (const [name, sizes] of [
  ["sh3", [6574, 9000]],
  ["tiles", [16700, 22000]],
]) {
  inBrowser(`splats of ${name} move from the picture before to the one after`, async (context) => {
    const { pose, pictures } = references(name, sizes);
    server.gate = 0;
    await open(`${name}.evogs`);
    await setPose(pose);
    const before = await letThrough(sizes[0]);
    const at = (seconds) =>
      page.evaluate((seconds) => {
        window.evogsViewer.renderer.clock = () => seconds;
      }, seconds);
    await at(0);
    const shown = [await letThrough(sizes[1])];
    for (const seconds of [0.05, 0.1, 0.15, 0.2, 0.25]) {
      await at(seconds);
      shown.push(await picture(page));
    }
    const popped = psnr(before, shown.at(-1));
    const steps = shown.slice(1).map((rgb, k) => psnr(rgb, shown[k]));
    context.diagnostic(
      `at once ${popped.toFixed(1)} dB; in steps ${steps.map((db) => db.toFixed(1)).join(", ")} dB`,
    );
    assert.ok(psnr(before, shown[0]) > 50, `${psnr(before, shown[0])} dB at the beginning`);
    assert.ok(Math.min(...steps) > popped + 4);
    assert.ok(psnr(shown.at(-1), pictures[1]) >= 42);
  });
}
