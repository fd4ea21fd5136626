/** How scenes come: over slow and lost connections, damaged, of many tiles and files, in part. */

import assert from "node:assert/strict";
import { picture, psnr, stateOf, until } from "./browser.mjs";
import { brightness, inBrowser, isDone, open, page, scenes, server, set, setPose } from "./page.mjs";
import { hostileDirectory, makeTileset, references } from "./scenes.mjs";

inBrowser("a throttled connection fills the picture, and no byte comes twice", async () => {
  server.bytesPerSecond = 60000;
  server.gate = Math.floor(0.3 * scenes.sh3.length);
  await open("sh3.evogs");
  await until(page, ({ progress }) => progress?.splats > 0, "the first splats");
  server.gate = Number.POSITIVE_INFINITY;
  const { progress } = await until(page, isDone, "the end");
  assert.equal(progress.splats, 8000);
  assert.equal(server.sent, scenes.sh3.length);
  assert.equal(server.requests[0], "bytes=0-65535");
  assert.ok(server.requests.length <= 5, server.requests.join());
});

inBrowser("a server that is killed midway and comes back loses nothing", async () => {
  server.bytesPerSecond = 40000;
  await open("sh3.evogs");
  await until(page, ({ progress }) => progress?.received > 40000, "some bytes");
  await server.stop();
  const down = await until(page, ({ notice }) => /interrupted|lost/.test(notice), "the notice");
  assert.ok(down.progress.splats > 0);
  assert.ok(brightness(await picture(page)) > 5, "what arrived stays on screen");
  const had = (await stateOf(page)).progress.received;
  const before = server.requests.length;
  server.bytesPerSecond = 0;
  await server.start();
  const { progress, notice } = await until(page, isDone, "the end");
  assert.equal(progress.received, scenes.sh3.length);
  assert.equal(progress.splats, 8000);
  assert.equal(notice, "");
  assert.equal(server.requests[before], `bytes=${had}-${/-(\d+)/.exec(server.requests[before])[1]}`);
  assert.equal(await page.textContent("#verified"), "verified");
});

inBrowser("a corrupted packet is reported, and the rest goes on", async () => {
  const bad = Buffer.from(scenes.sh3);
  bad[Math.floor(bad.length * 0.6)] ^= 1;
  server.scenes.set("bad.evogs", bad);
  await open("bad.evogs");
  const { progress, notice } = await until(page, isDone, "the end");
  assert.match(notice, /A packet is damaged \(E_CRC at byte \d+\)/);
  assert.equal(progress.received, bad.length);
  assert.ok(progress.splats > 1000 && progress.packetsApplied < progress.packets);
  assert.notEqual(await page.textContent("#verified"), "verified");
  assert.ok(brightness(await picture(page)) > 5);
});

inBrowser("bad files are told apart, and the page goes on", async () => {
  server.scenes.set("zeros.evogs", Buffer.alloc(100e6));
  server.scenes.set("text.evogs", Buffer.from("this is a text"));
  server.scenes.set("empty.evogs", Buffer.alloc(0));
  server.scenes.set("short.evogs", scenes.sh3.subarray(0, 50000));
  server.scenes.set("directory.evogs", scenes.sh3.subarray(0, 1000));
  server.scenes.set("hostile.evogs", hostileDirectory());
  const flipped = Buffer.from(scenes.sh3);
  flipped[300] ^= 1;
  server.scenes.set("flipped.evogs", flipped);
  const cases = {
    "missing.evogs": /no such file \(404\)/,
    "zeros.evogs": /not an EvoGS file/,
    "text.evogs": /not an EvoGS file/,
    "empty.evogs": /cut short/,
    "short.evogs": /cut short.*stays on screen/,
    "directory.evogs": /cut short/,
    "hostile.evogs": /damaged/,
    "flipped.evogs": /damaged: .*E_CRC/,
  };
  await page.goto(`http://127.0.0.1:${server.port}/`);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  for (const [name, expected] of Object.entries(cases)) {
    const before = server.sent;
    await page.evaluate((name) => window.evogsViewer.open(name), name);
    const { notice } = await until(page, ({ state, notice }) => state === "failed" && notice !== "", name);
    assert.match(notice, expected, name);
    if (name === "zeros.evogs") assert.ok(server.sent - before <= 65536);
    await page.evaluate(() => document.getElementById("notice").setAttribute("hidden", ""));
  }
  await page.evaluate(() => window.evogsViewer.open("javascript:alert(1)"));
  assert.match((await stateOf(page)).notice, /Only http/);
  await page.evaluate(() => window.evogsViewer.open("sh1.evogs"));
  const { progress } = await until(page, isDone, "a good file");
  assert.equal(progress.splats, 8000);
});

inBrowser("the camera moves while a scene of many tiles comes; all of it comes once", async () => {
  server.bytesPerSecond = 60000;
  await open("tiles.evogs");
  await until(page, ({ progress }) => progress?.splats > 0, "the first splats");
  await page.focus("#view");
  await page.mouse.move(290, 120);
  for (let k = 0; k < 6; k++) {
    await page.keyboard.press("w", { delay: 80 });
    await page.keyboard.press("ArrowLeft", { delay: 120 });
    await page.mouse.wheel(0, -60);
    await page.waitForTimeout(350);
  }
  const { progress } = await until(page, isDone, "the end");
  assert.equal(progress.splats, 8000);
  assert.equal(progress.received, scenes.tiles.length);
  assert.ok(server.requests.length <= 40, server.requests.join());
  assert.equal(await page.textContent("#verified"), "verified");
});

inBrowser("a budget of splats holds the stream back, and more can be had later", async () => {
  server.gate = 5000;
  await open("sh3.evogs");
  await until(page, () => server.requests.length > 0, "the first request");
  await page.waitForFunction(() => window.evogsViewer?.info !== null);
  await set("budget", 40);
  server.gate = Number.POSITIVE_INFINITY;
  const { progress } = await until(page, isDone, "what is wanted");
  // The first request, of 64 kB, was on its way.
  assert.ok(progress.splats < 8000 && progress.received < scenes.sh3.length, JSON.stringify(progress));
  await set("budget", 100);
  await until(page, ({ progress }) => progress.splats === 8000, "all");
  assert.equal(server.sent, scenes.sh3.length);
});

inBrowser("of a tileset the overview comes first, then the files for what is looked at", async (context) => {
  const files = makeTileset();
  for (const [name, bytes] of Object.entries(files)) server.scenes.set(name, bytes);
  const { pose, pictures } = references("sh3", [scenes.sh3.length]);
  const leaves = Object.keys(files).filter((name) => name.endsWith(".evogs") && !name.includes("root"));
  assert.equal(leaves.length, 4);
  for (const name of leaves) server.scenes.delete(name);
  server.held = new Set(leaves);
  await open("city/tileset.json");
  await setPose(pose);
  const first = await until(
    page,
    ({ progress }) => progress?.files?.length === 1 && progress.splats > 500,
    "overview",
  );
  assert.deepEqual(first.progress.files, ["root.evogs"]);
  server.held.clear();
  await until(page, ({ state }) => state === "failed", "a failure: files are not there");
  const overview = psnr(await picture(page), pictures[0]);
  // The boxes of files beside one another overlap; of the overview, which stands for all of them, nothing comes twice.
  const { splats } = JSON.parse(files["city/tileset.json"]).root.content.extras;
  assert.equal((await stateOf(page)).progress.splats, splats);
  for (const name of leaves) server.scenes.set(name, files[name]);
  await page.click("#retry");
  const { progress } = await until(page, isDone, "the end");
  assert.deepEqual(progress.files.sort(), leaves.map((name) => name.split("/").pop()).sort());
  assert.equal(progress.splats, 8000);
  assert.equal(progress.digests.wrong, 0);
  const whole = psnr(await picture(page), pictures[0]);
  context.diagnostic(`${overview.toFixed(1)} dB, then ${whole.toFixed(1)} dB`);
  assert.ok(overview > 15 && whole > overview + 3 && whole > 30, `${overview} dB, then ${whole} dB`);
});
