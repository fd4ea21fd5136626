/** What the page draws while a scene comes, beside the pictures of the rasterizer. */

import assert from "node:assert/strict";
import { picture, psnr, stateOf, until } from "./browser.mjs";
import {
  brightness,
  inBrowser,
  isDone,
  letThrough,
  moveAtOnce,
  open,
  page,
  scenes,
  server,
  setPose,
} from "./page.mjs";
import { references } from "./scenes.mjs";

/** dB; pictures of the same splats differ by less from one run to the next. */
const NOISE = 0.01;

const every = (percent) => Array.from({ length: 100 / percent }, (_, k) => percent * (k + 1));

// Pictures at some percent of the bytes are compared, and none of the others is worse than one before. The more splats
// lie over each other, the more 8-bit blending rounds.
for (const [name, percents, least, all = percents] of [
  ["sh3", [5, 10, 20, 50, 100], 42],
  ["sh1", [5, 10, 20, 50, 100], 42],
  ["five", [10, 20, 50, 100], 42],
  ["default", [5, 10, 20, 50, 100], 41, every(5)],
]) {
  const isDense = all.length > percents.length;
  const grows = isDense ? `; quality never falls over ${all.length} snapshots` : "";
  const title = `pictures at ${percents.join(", ")} % of ${name} are those of the rasterizer${grows}`;
  inBrowser(title, async (context) => {
    const bytes = scenes[name];
    const sizeAt = (percent) => Math.floor((bytes.length * percent) / 100);
    const { pose, pictures } = references(name, percents.map(sizeAt));
    server.gate = 0;
    await open(`${name}.evogs`);
    await setPose(pose);
    server.bytesPerSecond = isDense ? 0 : 100000;
    // Each picture of splats that move costs as much as one of splats that are there.
    if (name !== "sh3") await moveAtOnce();
    const found = [];
    const toWhole = [];
    for (const percent of all) {
      const shown = await letThrough(sizeAt(percent));
      assert.equal((await stateOf(page)).progress.received, sizeAt(percent));
      if (percent === all[0]) assert.ok(brightness(shown) > 5, `there is something to see at ${percent} %`);
      if (percents.includes(percent)) found.push(psnr(shown, pictures[percents.indexOf(percent)]));
      toWhole.push(psnr(shown, pictures.at(-1)));
    }
    context.diagnostic(`${name}: ${found.map((db) => db.toFixed(1)).join(", ")} dB at ${percents.join(", ")} %`);
    for (const db of found) assert.ok(db >= least, `${db} dB`);
    if (isDense) {
      context.diagnostic(`to the whole: ${toWhole.map((db) => db.toFixed(2)).join(", ")} dB`);
      for (let k = 1; k < toWhole.length; k++) {
        assert.ok(toWhole[k] >= toWhole[k - 1] - NOISE, `snapshot ${k}: ${toWhole}`);
      }
      assert.ok(toWhole.at(-1) > toWhole[0] + 20);
    }
    const { progress } = await until(page, isDone, "the end");
    assert.equal(progress.digests.checked, progress.digests.rows);
    assert.ok(progress.digests.rows > 0);
    assert.equal(progress.digests.wrong, 0);
    assert.equal(await page.textContent("#verified"), "verified");
  });
}

// Splits of level 1; and tiles that have no splat before, beside splits of others.
for (const [name, sizes] of [
  ["sh3", [6574, 9000]],
  ["tiles", [16400, 22200]],
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
