/** The page itself: what it is opened with, what it offers, and how it is served. */

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { readFile, readdir } from "node:fs/promises";
import { test } from "node:test";
import { hold, picture, psnr, stateOf, until } from "./browser.mjs";
import { brightness, inBrowser, isDone, open, page, scenes, server, set, setPose } from "./page.mjs";
import { PYTHON, exportedPage, references, scenePath } from "./scenes.mjs";

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

inBrowser("local files: the picker, and drag and drop", async () => {
  await page.goto(`http://127.0.0.1:${server.port}/`);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  await page.setInputFiles("#file", scenePath("small"));
  const { progress } = await until(page, isDone, "the file");
  assert.equal(progress.received, scenes.small.length);
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
  await page.goto(server.url("small.evogs"));
  await page.waitForSelector("#notice:not([hidden])");
  assert.match(await page.textContent("#notice-text"), /no WebGL2/);
});

inBrowser("without WebGPU nothing is missing", async () => {
  await page.addInitScript(() => {
    Object.defineProperty(navigator, "gpu", { value: undefined });
  });
  await open("small.evogs");
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
  await hold(page, "ArrowLeft");
  const after = await look();
  assert.ok(apart(after.eye, eye) > 0.01);
  assert.ok(Math.abs(apart(after.eye, stored.target) - apart(eye, stored.target)) < 1e-6);
});

inBrowser("evogs view serves the installed page and the scene", async () => {
  const parameters = ["-m", "evogs_codec.cli.commands", "view", scenePath("small"), "--no-browser"];
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
    assert.equal(progress.splats, 1000);
    assert.equal(await page.textContent("#verified"), "verified");
  } finally {
    view.kill();
  }
});

inBrowser("evogs export-html makes a page that works from a file, as the served one does", async () => {
  const { pose } = references("sh3", [scenes.sh3.length]);
  await open("small.evogs");
  await setPose(pose);
  await until(page, isDone, "the end");
  const served = await picture(page);
  const address = exportedPage("small");
  const requests = [];
  page.on("request", (request) => requests.push(request.url()));
  await page.goto(address);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  await setPose(pose);
  const { progress } = await until(page, isDone, "the end");
  assert.equal(progress.splats, 1000);
  assert.equal(await page.textContent("#verified"), "verified");
  assert.equal(await page.textContent("#name"), "small.evogs");
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
