/** Chromium with a software GL, and pictures of its canvas. */

import { existsSync } from "node:fs";
import { chromium } from "playwright-core";

const CHROMIUM = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
const ARGUMENTS = [
  "--no-sandbox",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--ignore-gpu-blocklist",
  "--disable-dev-shm-usage",
];

/** The path of a browser, or null if there is none. CHROMIUM in the environment names another one. */
export function findChromium() {
  const paths = process.env.CHROMIUM ? [process.env.CHROMIUM] : [...CHROMIUM, chromium.executablePath()];
  return paths.find((path) => existsSync(path)) ?? null;
}

export function launch() {
  return chromium.launch({ executablePath: findChromium(), headless: true, args: ARGUMENTS });
}

/** What the page knows. */
export function stateOf(page) {
  return page.evaluate(() => ({
    state: document.body.dataset.state,
    isSettled: window.evogsViewer?.isSettled ?? false,
    progress: window.evogsViewer?.progress ?? null,
    notice: document.getElementById("notice").hidden ? "" : document.getElementById("notice-text").textContent,
  }));
}

/** Waits until `holds` of the state of the page; returns the state. */
export async function until(page, holds, what, seconds = 60) {
  const end = Date.now() + 1000 * seconds;
  for (;;) {
    const state = await stateOf(page);
    if (holds(state)) return state;
    if (Date.now() > end) throw new Error(`${what} did not come true: ${JSON.stringify(state)}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

/** Presses a key for a while, and waits until what it does is done: keys count with frames, which may come late. */
export async function hold(page, key) {
  await page.keyboard.press(key, { delay: 300 });
  await page.waitForFunction(() => {
    const { held, released } = window.evogsViewer.controls;
    return held.size === 0 && released.size === 0;
  });
}

/** The canvas as 8-bit RGB, once nothing more is to be drawn. */
export async function picture(page) {
  for (let calm = 0; calm < 3; ) {
    calm = (await stateOf(page)).isSettled ? calm + 1 : 0;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  const text = await page.evaluate(() => {
    const canvas = document.getElementById("view");
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const context = copy.getContext("2d", { willReadFrequently: true });
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, copy.width, copy.height);
    let out = "";
    for (let i = 0; i < data.length; i += 4) out += String.fromCharCode(data[i], data[i + 1], data[i + 2]);
    return btoa(out);
  });
  return Buffer.from(text, "base64");
}

export function psnr(a, b) {
  if (a.length !== b.length) throw new Error(`pictures of ${a.length} and ${b.length} bytes`);
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += (a[i] - b[i]) ** 2;
  return sum === 0 ? Number.POSITIVE_INFINITY : 10 * Math.log10((255 * 255 * a.length) / sum);
}
