/** What is told of servers that do not answer as they should, and of tilesets that lack files. */

import assert from "node:assert/strict";
import { picture, psnr, stateOf, until } from "./browser.mjs";
import { inBrowser, isDone, open, page, scenes, server, set, setPose } from "./page.mjs";
import { makeTileset, references } from "./scenes.mjs";
import { PageServer } from "./server.mjs";

const openHere = (address) => page.evaluate((address) => window.evogsViewer.open(address), address);

inBrowser("a server that refuses pages of other origins is told from one that is not there", async () => {
  const other = new PageServer();
  other.scenes.set("small.evogs", scenes.small);
  await other.start();
  const address = `http://127.0.0.1:${other.port}/small.evogs`;
  try {
    await open(encodeURIComponent(address));
    const { notice, state } = await until(page, ({ notice }) => notice !== "", "the notice", 4);
    assert.match(notice, /Access-Control-Allow-Origin/);
    assert.notEqual(state, "done");
  } finally {
    await other.stop();
  }
  await openHere(address);
  const { notice } = await until(page, ({ notice }) => notice !== "", "the notice", 4);
  assert.match(notice, /does not answer/);
});

inBrowser("the status of a server that is busy is told, and that nothing is lost", async () => {
  server.status = 503;
  await open("small.evogs");
  const { notice } = await until(page, ({ notice }) => notice !== "", "the notice", 4);
  assert.equal(notice, "The server answers 503: trying again.");
  server.status = 0;
  assert.equal((await until(page, isDone, "the end")).notice, "");
});

inBrowser("that no byte comes is told after a while, until bytes come", async () => {
  server.gate = 0;
  await page.clock.install();
  await open("small.evogs");
  // As if 5 seconds had gone by.
  const wait = () => page.clock.fastForward(5000);
  await until(page, ({ progress }) => progress !== null, "an open scene");
  assert.equal((await stateOf(page)).notice, "");
  await wait();
  await until(page, ({ notice }) => /sent nothing for 5 seconds/.test(notice), "the notice");
  await page.keyboard.press("p");
  await until(page, ({ notice }) => notice === "", "a pause");
  await page.keyboard.press("p");
  await until(page, ({ progress }) => !progress.isPaused, "no pause");
  await wait();
  await until(page, ({ notice }) => /sent nothing/.test(notice), "the notice again");
  server.gate = Number.POSITIVE_INFINITY;
  assert.equal((await until(page, isDone, "the end")).notice, "");
});

/** Serves a tileset, and opens it with the camera of the pictures. */
async function openTileset(change = () => {}, files = makeTileset()) {
  for (const [name, bytes] of Object.entries(files)) server.scenes.set(name, bytes);
  const names = Object.keys(files).filter((name) => name.endsWith(".evogs") && !name.includes("root"));
  await change(files, names);
  await open("city/tileset.json");
  await setPose(references("sh3", [scenes.sh3.length]).pose);
  return { files, names };
}

inBrowser("of a tileset that lacks a file the others come; an overview fills the gap", async (context) => {
  const [expected] = references("sh3", [scenes.sh3.length]).pictures;
  let missing;
  const { files, names } = await openTileset((_, names) => {
    missing = names[1];
    server.scenes.delete(missing);
  });
  const { notice, progress } = await until(
    page,
    // The overview as a whole is there until the others have come.
    ({ state, progress }) => state === "failed" && progress.splats > 6000 && progress.splats < 7000,
    "all others, and what stands for it",
    20,
  );
  assert.match(notice, /1 file cannot be read \(tiles\/.*evogs: the server answers 404/);
  assert.ok(notice.includes(missing.replace("city/", "")));
  assert.equal(progress.files.length, names.length);
  assert.ok(progress.splats < 7000, `${progress.splats}`);
  assert.equal(await page.textContent("#verified"), "1 file missing");
  const partly = psnr(await picture(page), expected);
  server.scenes.set(missing, files[missing]);
  await page.click("#retry");
  const last = await until(page, isDone, "the end");
  assert.equal(last.notice, "");
  assert.equal(last.progress.splats, 8000);
  assert.equal(await page.textContent("#verified"), "verified");
  const whole = psnr(await picture(page), expected);
  context.diagnostic(`${partly.toFixed(1)} dB, then ${whole.toFixed(1)} dB`);
  assert.ok(partly > 18 && whole > 30, `${partly} dB, then ${whole} dB`);
});

inBrowser("of a tileset the SH of a degree that is raised come later, and all is drawn meanwhile", async () => {
  // Their first requests do not bring all of these files.
  const files = makeTileset("larger", 13000);
  server.bytesPerSecond = 100000;
  await openTileset(() => {}, files);
  await page.waitForFunction(() => window.evogsViewer.info !== null);
  await set("degree", 0);
  const isWhole = ({ state, progress }) => state === "done" && progress.splats === 24000;
  const flat = (await until(page, isWhole, "the end")).progress;
  assert.ok(flat.received < flat.size, `${flat.received} of ${flat.size}`);
  await set("degree", 3);
  const drawn = [];
  const all = await until(
    page,
    ({ state, progress }) => {
      drawn.push(progress.splats);
      return state === "done" && progress.received > flat.received;
    },
    "SH",
  );
  assert.equal(all.progress.received, all.progress.size);
  assert.equal(all.progress.digests.checked, all.progress.digests.rows);
  assert.deepEqual([...new Set(drawn)], [24000]);
});

inBrowser("a tileset that does not say its size has no total, and none can be looked back at", async () => {
  await openTileset((files) => {
    const tileset = JSON.parse(files["city/tileset.json"]);
    tileset.extras.evogs.splats = undefined;
    server.scenes.set("city/tileset.json", Buffer.from(JSON.stringify(tileset)));
  });
  await until(page, isDone, "the end");
  assert.equal(await page.textContent("#splats"), "8,000");
  assert.ok(await page.isDisabled("#timeline"));
  assert.equal((await stateOf(page)).notice, "");
});
