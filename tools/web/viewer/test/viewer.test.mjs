/** The page in a real browser, with a software GL. */

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { readFile, readdir } from "node:fs/promises";
import { after, afterEach, before, beforeEach, test } from "node:test";
import { findChromium, launch, picture, psnr, stateOf, until } from "./browser.mjs";
import {
  PYTHON,
  exportedPage,
  hostileDirectory,
  makeScenes,
  makeTileset,
  references,
  scenePath,
  whyNoCodec,
} from "./scenes.mjs";
import { PageServer } from "./server.mjs";

const skip =
  findChromium() === null ? "no Chromium: apt-get install chromium, or CHROMIUM=..." : (whyNoCodec() ?? false);
const SIZE = { width: 320, height: 240 };

let scenes;
let server;
let browser;
let page;
let errors;

before(async () => {
  if (skip) return;
  scenes = makeScenes();
  browser = await launch();
});

after(async () => {
  await browser?.close();
});

beforeEach(async () => {
  if (skip) return;
  server = new PageServer();
  for (const [name, bytes] of Object.entries(scenes)) server.scenes.set(`${name}.evogs`, bytes);
  await server.start();
  page = await browser.newPage({ viewport: SIZE });
  errors = [];
  page.on("pageerror", (error) => errors.push(String(error)));
});

afterEach(async () => {
  await page?.close();
  await server?.stop();
});

/** A test that leaves no error on the page. */
function inBrowser(name, body) {
  test(name, { skip, timeout: 240000 }, async (context) => {
    await body(context);
    assert.deepEqual(errors, []);
  });
}

async function open(scene) {
  await page.goto(server.url(scene));
  await page.waitForFunction(() => window.evogsViewer !== undefined);
}

const isDone = ({ state }) => state === "done";
const setPose = (pose) => page.evaluate((pose) => window.evogsViewer.setPose(pose), pose);
const set = (id, value) =>
  page.evaluate(
    ([id, value]) => {
      const slider = document.getElementById(id);
      slider.value = value;
      slider.dispatchEvent(new Event("input"));
    },
    [id, String(value)],
  );
const brightness = (rgb) => rgb.reduce((sum, x) => sum + x, 0) / rgb.length;

/** Lets bytes through up to `size`, and waits until they are drawn. */
async function letThrough(size) {
  server.gate = size;
  await until(page, ({ progress }) => progress?.received >= size, `${size} bytes`);
  return picture(page);
}

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
  for (let k = 1; k < found.length; k++) assert.ok(found[k] >= found[k - 1] - 0.1, `snapshot ${k}: ${found}`);
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

inBrowser("a throttled connection fills the picture, and no byte comes twice", async () => {
  server.bytesPerSecond = 60000;
  await open("sh3.evogs");
  const early = await until(page, ({ progress }) => progress?.splats > 0, "the first splats");
  assert.ok(early.progress.received < 0.3 * scenes.sh3.length, `${early.progress.received}`);
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

inBrowser("sliders, pause and the timeline", async () => {
  server.bytesPerSecond = 50000;
  await open("sh3.evogs");
  await until(page, ({ progress }) => progress?.received > 20000, "some bytes");
  await page.keyboard.press("p");
  await page.waitForTimeout(300);
  const paused = (await stateOf(page)).progress.received;
  await page.waitForTimeout(700);
  assert.equal((await stateOf(page)).progress.received, paused);
  await page.keyboard.press("p");
  server.bytesPerSecond = 0;
  await until(page, isDone, "the end");

  const whole = await picture(page);
  await set("degree", 0);
  const flat = await picture(page);
  assert.ok(psnr(whole, flat) < 60, "SH change the picture");
  await set("degree", 3);
  assert.ok(psnr(whole, await picture(page)) > 60, "and are there again");

  await set("timeline", Math.floor(0.3 * scenes.sh3.length));
  const past = await until(page, ({ progress }) => progress.splats < 8000, "the past");
  assert.ok(past.progress.received <= 0.3 * scenes.sh3.length);
  assert.ok(psnr(whole, await picture(page)) < 40);
  await set("timeline", Math.floor(0.6 * scenes.sh3.length));
  await until(page, ({ progress }) => progress.splats > past.progress.splats, "later");
  await set("timeline", scenes.sh3.length);
  await until(page, ({ progress }) => progress.splats === 8000, "the present");
  assert.ok(psnr(whole, await picture(page)) > 60);
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

inBrowser("local files: the picker, and drag and drop", async () => {
  await page.goto(`http://127.0.0.1:${server.port}/`);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  await page.setInputFiles("#file", scenePath("sh1"));
  const { progress } = await until(page, isDone, "the file");
  assert.equal(progress.received, scenes.sh1.length);
  assert.equal(await page.textContent("#verified"), "verified");
  await page.evaluate(
    (bytes) => {
      const transfer = new DataTransfer();
      transfer.items.add(new File([new Uint8Array(bytes)], "text.evogs"));
      document.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer }));
    },
    [1, 2, 3],
  );
  const { notice } = await until(page, ({ state }) => state === "failed", "the text");
  assert.match(notice, /not an EvoGS file/);
  assert.equal(server.requests.length, 0);
});

inBrowser("without WebGL2 the page says so", async () => {
  await page.addInitScript(() => {
    HTMLCanvasElement.prototype.getContext = () => null;
  });
  await page.goto(server.url("sh1.evogs"));
  await page.waitForSelector("#notice:not([hidden])");
  assert.match(await page.textContent("#notice-text"), /no WebGL2/);
});

inBrowser("without WebGPU nothing is missing", async () => {
  await page.addInitScript(() => {
    Object.defineProperty(navigator, "gpu", { value: undefined });
  });
  await open("sh1.evogs");
  await until(page, isDone, "the end");
  assert.ok(brightness(await picture(page)) > 5);
});

inBrowser("the page opens with the default camera of a stream, and turns around its target", async () => {
  await open("camera.evogs");
  await until(page, isDone, "the end");
  const look = () =>
    page.evaluate(() => {
      const { info, camera } = window.evogsViewer;
      return { stored: info.camera, eye: [...camera.pose.eye], fovY: camera.pose.fovY };
    });
  const apart = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));
  const { stored, eye, fovY } = await look();
  assert.ok(apart(eye, stored.position) < 1e-6, `${eye} is not ${stored.position}`);
  assert.ok(Math.abs(fovY - (stored.fovY * Math.PI) / 180) < 1e-9);
  assert.ok(brightness(await picture(page)) > 5);
  await page.focus("#view");
  await page.keyboard.press("ArrowLeft", { delay: 300 });
  const after = await look();
  assert.ok(apart(after.eye, eye) > 0.01);
  assert.ok(Math.abs(apart(after.eye, stored.target) - apart(eye, stored.target)) < 1e-6);
});

inBrowser("evogs view serves the installed page and the scene", async () => {
  const parameters = ["-m", "evogs_codec.cli.commands", "view", scenePath("sh1"), "--no-browser"];
  const root = new URL("../../../../", import.meta.url);
  const view = spawn(PYTHON, parameters, { cwd: root, stdio: ["ignore", "pipe", "inherit"] });
  try {
    const address = await new Promise((resolve, reject) => {
      view.stdout.once("data", (text) => resolve(String(text).split("\n")[0]));
      view.once("exit", () => reject(new Error("evogs view ended")));
    });
    await page.goto(address);
    await page.waitForFunction(() => window.evogsViewer !== undefined);
    const { progress } = await until(page, isDone, "the end");
    assert.equal(progress.splats, 8000);
    assert.equal(await page.textContent("#verified"), "verified");
  } finally {
    view.kill();
  }
});

inBrowser("evogs export-html makes a page that works from a file, as the served one does", async () => {
  const { pose } = references("five", [scenes.five.length]);
  await open("five.evogs");
  await setPose(pose);
  await until(page, isDone, "the end");
  const served = await picture(page);
  const address = exportedPage("five");
  const requests = [];
  page.on("request", (request) => requests.push(request.url()));
  await page.goto(address);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  await setPose(pose);
  const { progress } = await until(page, isDone, "the end");
  assert.equal(progress.splats, 8000);
  assert.equal(await page.textContent("#verified"), "verified");
  assert.equal(await page.textContent("#name"), "five.evogs");
  assert.ok(brightness(served) > 5);
  const db = psnr(served, await picture(page));
  assert.ok(db > 60, `${db} dB`);
  // In so small a window the panel is folded.
  await page.click("summary");
  await page.click("#link");
  await until(page, ({ notice }) => notice === "The link is copied.", "the link");
  assert.match(page.url(), /^file:.*#view=/);
  assert.deepEqual(
    requests.filter((url) => !/^(data|blob):/.test(url)),
    [address],
  );
});

test("the page in the Python package is the one that is built here: make web", async () => {
  const built = new URL("../dist/", import.meta.url);
  const installed = new URL("../../../../evogs_codec/cli/viewer/page/", import.meta.url);
  const names = (await readdir(built)).sort();
  assert.deepEqual((await readdir(installed)).sort(), names);
  for (const name of names) {
    assert.ok((await readFile(new URL(name, built))).equals(await readFile(new URL(name, installed))), name);
  }
});

inBrowser("of a tileset the overview comes first, then the files for what is looked at", async (context) => {
  const files = makeTileset();
  for (const [name, bytes] of Object.entries(files)) server.scenes.set(name, bytes);
  const { pose, pictures } = references("sh3", [scenes.sh3.length]);
  const leaves = Object.keys(files).filter((name) => name.endsWith(".evogs") && !name.includes("root"));
  assert.equal(leaves.length, 4);
  for (const name of leaves) server.scenes.delete(name);
  await open("city/tileset.json");
  await setPose(pose);
  const first = await until(
    page,
    ({ progress }) => progress?.files?.length === 1 && progress.splats > 500,
    "overview",
  );
  assert.deepEqual(first.progress.files, ["root.evogs"]);
  await until(page, ({ state }) => state === "failed", "a failure: files are not there");
  const overview = psnr(await picture(page), pictures[0]);
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
