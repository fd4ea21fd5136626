/** The page in stock Firefox, over WebDriver BiDi, with the software GL of Mesa. */

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { after, before, test } from "node:test";
import puppeteer from "puppeteer-core";
import { findChromium, launch, picture, psnr, until } from "./browser.mjs";
import { makeScenes, references, whyNoCodec } from "./scenes.mjs";
import { PageServer } from "./server.mjs";

const FIREFOX = ["/usr/bin/firefox-esr", "/usr/bin/firefox"];
const XVFB = "/usr/bin/Xvfb";
const SIZE = { width: 320, height: 240 };

/** The path of a browser, or null. FIREFOX in the environment names another one. */
function findFirefox() {
  return (process.env.FIREFOX ? [process.env.FIREFOX] : FIREFOX).find((path) => existsSync(path)) ?? null;
}

/** Without a screen, Firefox offers no WebGL. */
function whyNot() {
  if (findFirefox() === null) return "no Firefox: apt-get install firefox-esr, or FIREFOX=...";
  if (!process.env.DISPLAY && !existsSync(XVFB)) return "no screen for Firefox: apt-get install xvfb";
  return whyNoCodec();
}

const skip = whyNot() ?? false;
let scenes;
let server;
let screen;
let firefox;

before(async () => {
  if (skip) return;
  scenes = makeScenes();
  server = new PageServer();
  server.scenes.set("sh3.evogs", scenes.sh3);
  await server.start();
  const env = { ...process.env, LIBGL_ALWAYS_SOFTWARE: "1" };
  if (!env.DISPLAY) {
    // It prints the number of a screen that is free.
    const words = ["-displayfd", "1", "-screen", "0", "1024x768x24", "-nolisten", "tcp"];
    screen = spawn(XVFB, words, { stdio: ["ignore", "pipe", "ignore"] });
    env.DISPLAY = `:${await new Promise((resolve) => screen.stdout.once("data", (text) => resolve(String(text).trim())))}`;
  }
  firefox = await puppeteer.launch({
    browser: "firefox",
    executablePath: findFirefox(),
    headless: false,
    defaultViewport: null,
    env,
    extraPrefsFirefox: { "webgl.force-enabled": true },
  });
});

after(async () => {
  await firefox?.close();
  screen?.kill();
  await server?.stop();
});

/** Gives a page its size. Firefox 140 refuses to turn the screen, which Puppeteer asks for beside it. */
async function resize(page) {
  await page.setViewport(SIZE).catch((error) => {
    if (!/unknown command emulation.setScreenOrientationOverride/.test(error.message)) throw error;
  });
  await page.waitForFunction(({ width, height }) => innerWidth === width && innerHeight === height, {}, SIZE);
}

/** Opens a scene, and waits until all of it is there; what is seen then from a pose. */
async function seen(page, pose) {
  await page.goto(server.url("sh3.evogs"));
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  await page.evaluate((pose) => window.evogsViewer.setPose(pose), pose);
  const early = await until(page, ({ progress }) => progress?.splats > 0, "the first splats", 120);
  const { progress } = await until(page, ({ state }) => state === "done", "the end", 120);
  return { early: early.progress, progress, rgb: await picture(page) };
}

test(
  "Firefox, which has no WebGPU: a scene streams in, and looks as in Chromium",
  { skip, timeout: 300000 },
  async (context) => {
    const { pose, pictures } = references("sh3", [scenes.sh3.length]);
    const page = await firefox.newPage();
    await resize(page);
    const errors = [];
    page.on("pageerror", (error) => errors.push(String(error)));
    server.bytesPerSecond = 60000;
    const { early, progress, rgb } = await seen(page, pose);
    assert.ok(early.received < scenes.sh3.length / 2, `splats come with ${early.received} bytes`);
    assert.equal(progress.splats, 8000);
    assert.equal(server.sent, scenes.sh3.length);
    assert.equal(await page.$eval("#verified", (element) => element.textContent), "verified");
    assert.equal(await page.evaluate(() => navigator.gpu === undefined), true);
    const found = [psnr(rgb, pictures[0])];
    assert.ok(found[0] >= 42, `${found[0]} dB to the rasterizer`);

    // By the keyboard and the mouse of another browser.
    const distance = () => page.evaluate(() => window.evogsViewer.camera.distance);
    await page.focus("#view");
    const before = await distance();
    await page.keyboard.press("+");
    assert.ok(Math.abs((await distance()) / before - 0.9) < 1e-6);
    const yaw = () => page.evaluate(() => window.evogsViewer.camera.yaw);
    const ahead = await yaw();
    await page.mouse.move(200, 180);
    await page.mouse.down();
    await page.mouse.move(240, 180);
    await page.mouse.up();
    assert.ok(Math.abs((await yaw()) - ahead + 0.2) < 1e-6);
    assert.deepEqual(errors, []);

    // Both round each splat to 8 bits, in ways of their own.
    if (findChromium() !== null) {
      const chromium = await launch();
      server.bytesPerSecond = 0;
      found.push(psnr(rgb, (await seen(await chromium.newPage({ viewport: SIZE }), pose)).rgb));
      await chromium.close();
      assert.ok(found[1] >= 40, `${found[1]} dB to Chromium`);
    }
    context.diagnostic(`${found.map((db) => db.toFixed(1)).join(" dB to the rasterizer, ")} dB to Chromium`);
  },
);
