/**
 * What the tests of the page share: one browser, and for each test a server of the scenes and a page.
 *
 * `server` and `page` are those of the test that runs.
 */

import assert from "node:assert/strict";
import { after, afterEach, before, beforeEach, test } from "node:test";
import { findChromium, launch, picture, until } from "./browser.mjs";
import { makeScenes, whyNoCodec } from "./scenes.mjs";
import { PageServer } from "./server.mjs";

const skip =
  findChromium() === null ? "no Chromium: apt-get install chromium, or CHROMIUM=..." : (whyNoCodec() ?? false);
const SIZE = { width: 320, height: 240 };

/** The bytes of each scene, by its name. */
export let scenes;
export let server;
export let page;
let browser;
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
  server?.held.clear();
  await page?.close();
  await server?.stop();
});

/** A test that leaves no error on the page. */
export function inBrowser(name, body) {
  test(name, { skip, timeout: 240000 }, async (context) => {
    await body(context);
    assert.deepEqual(errors, []);
  });
}

export async function open(scene) {
  await page.goto(server.url(scene));
  await page.waitForFunction(() => window.evogsViewer !== undefined);
}

export const isDone = ({ state }) => state === "done";
export const setPose = (pose) => page.evaluate((pose) => window.evogsViewer.setPose(pose), pose);
export const set = (id, value) =>
  page.evaluate(
    ([id, value]) => {
      const slider = document.getElementById(id);
      slider.value = value;
      slider.dispatchEvent(new Event("input"));
    },
    [id, String(value)],
  );
export const brightness = (rgb) => rgb.reduce((sum, x) => sum + x, 0) / rgb.length;

/** Splats move to their new states at once: a clock goes by a second whenever it is asked. */
export const moveAtOnce = () =>
  page.evaluate(() => {
    let seconds = 0;
    window.evogsViewer.renderer.clock = () => seconds++;
  });

/** Lets bytes through up to `size`, and waits until they are drawn. */
export async function letThrough(size) {
  server.gate = size;
  await until(page, ({ progress }) => progress?.received >= size, `${size} bytes`);
  return picture(page);
}
