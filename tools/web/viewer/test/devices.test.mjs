/** The page on a phone, and from the keyboard alone. */

import assert from "node:assert/strict";
import { after, afterEach, before, beforeEach, test } from "node:test";
import { findChromium, hold, launch, stateOf, until } from "./browser.mjs";
import { exampleScene, makeScenes, whyNoCodec } from "./scenes.mjs";
import { PageServer } from "./server.mjs";

const skip =
  findChromium() === null ? "no Chromium: apt-get install chromium, or CHROMIUM=..." : (whyNoCodec() ?? false);
const PHONE = { viewport: { width: 390, height: 760 }, deviceScaleFactor: 3, isMobile: true, hasTouch: true };
/** What a finger needs, in CSS pixels (WCAG 2.5.5). */
const FINGER = 44;

let scenes;
let server;
let browser;
let context;
let page;
let errors;

before(async () => {
  if (skip) return;
  scenes = makeScenes();
  browser = await launch();
});

after(() => browser?.close());

beforeEach(async () => {
  if (skip) return;
  server = new PageServer();
  for (const [name, bytes] of Object.entries(scenes)) server.scenes.set(`${name}.evogs`, bytes);
  await server.start();
});

afterEach(async () => {
  await context?.close();
  await server?.stop();
});

/** A test on a device, that leaves no error on the page. */
function onDevice(name, device, body) {
  test(name, { skip, timeout: 240000 }, async (test) => {
    context = await browser.newContext(device);
    page = await context.newPage();
    errors = [];
    page.on("pageerror", (error) => errors.push(String(error)));
    await body(test);
    assert.deepEqual(errors, []);
  });
}

async function open(address) {
  await page.goto(address);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
}

const isDone = ({ state }) => state === "done";
const camera = () =>
  page.evaluate(() => {
    const { pose, target, distance, yaw, pitch } = window.evogsViewer.camera;
    return { eye: [...pose.eye], target: [...target], distance, yaw, pitch };
  });
const apart = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));

/** Fingers that go from their first places to their last ones. */
async function fingers(...ways) {
  const session = await context.newCDPSession(page);
  const steps = 8;
  const at = (k) => ways.map(([from, to], id) => ({ id, ...between(from, to, k / steps) }));
  const send = (type, touchPoints) => session.send("Input.dispatchTouchEvent", { type, touchPoints });
  await send("touchStart", at(0));
  for (let k = 1; k <= steps; k++) await send("touchMove", at(k));
  await send("touchEnd", []);
}

/** Taps until `holds` on the page: where it is busy, a finger may rest for so long that it is no tap. */
async function tap(selector, holds, options = {}) {
  for (let k = 0; k < 5; k++) {
    await until(page, ({ isSettled }) => isSettled, "rest");
    await page.tap(selector, options);
    const isDone = await page.waitForFunction(holds, null, { timeout: 2000 }).catch(() => null);
    if (isDone !== null) return;
  }
  throw new Error(`taps on ${selector} do nothing`);
}

const isOpen = () => document.getElementById("panel").open;
const isFolded = () => !document.getElementById("panel").open;
const isFlying = () => document.getElementById("fly").checked;

const between = ([x0, y0], [x1, y1], part) => ({ x: x0 + part * (x1 - x0), y: y0 + part * (y1 - y0) });

for (const [name, viewport] of [
  ["upright", PHONE.viewport],
  ["turned", { width: 760, height: 360 }],
]) {
  onDevice(
    `a phone, ${name}: the picture is not hidden, and all controls fit fingers`,
    { ...PHONE, viewport },
    async () => {
      // From so far that splats cover few pixels: software draws them.
      await open(`${server.url("small.evogs")}#view=0,0,0,500,0.5,0.5,30`);
      await until(page, isDone, "the end");
      const { width, height } = viewport;
      const layout = await page.evaluate(() => {
        const { width, height } = document.getElementById("panel").getBoundingClientRect();
        const canvas = document.getElementById("view");
        const { scrollWidth, scrollHeight } = document.documentElement;
        return {
          panel: width * height,
          pixels: [canvas.width, canvas.height],
          scrolls: [scrollWidth, scrollHeight],
        };
      });
      assert.ok(layout.panel < 0.07 * width * height, `the panel takes ${layout.panel} square pixels`);
      // Twice as many pixels as CSS has: three times would cost more than twice as much again.
      assert.deepEqual(layout.pixels, [2 * width, 2 * height]);
      assert.deepEqual(layout.scrolls, [width, height]);
      assert.equal(await page.textContent("#brief"), `${Math.round(scenes.small.length / 1e3)} kB`);

      await tap("summary", isOpen);
      for (const id of [
        "open",
        "url",
        "rate",
        "budget",
        "degree",
        "pause",
        "fit",
        "up",
        "link",
        "fly",
        "timeline",
      ]) {
        const control = page.locator(id === "fly" ? "label.check" : `#${id}`);
        await control.scrollIntoViewIfNeeded();
        const box = await control.boundingBox();
        assert.ok(box.height >= FINGER && box.width >= FINGER, `${id}: ${box.width} x ${box.height}`);
        assert.ok(box.x >= 0 && box.x + box.width <= width, `${id} is beside the screen`);
        assert.ok(box.y >= 0 && box.y + box.height <= height, `${id} is below the screen`);
      }
      await tap("label.check", isFlying);
      const { height: high } = await page.locator("#degree").boundingBox();
      const position = { x: 3, y: high / 2 };
      await tap("#degree", () => document.getElementById("degree").value === "0", { position });
      await tap("#pause", () => document.getElementById("pause").textContent === "Resume");
      await tap("summary", isFolded);
      assert.ok(!(await page.isVisible("#pause")));
    },
  );
}

// Fewer pixels than a phone has, since software draws them.
const SMALL = { ...PHONE, viewport: { width: 320, height: 480 }, deviceScaleFactor: 1 };

onDevice("a phone: one finger turns, two fingers zoom and move", SMALL, async () => {
  server.scenes.set("example.evogs", exampleScene());
  await open(server.url("example.evogs"));
  await until(page, isDone, "the end");
  const start = await camera();

  await fingers([
    [200, 300],
    [260, 330],
  ]);
  const turned = await camera();
  assert.ok(apart(turned.eye, start.eye) > 0.1 * start.distance);
  assert.ok(apart(turned.target, start.target) < 1e-9 && Math.abs(turned.distance - start.distance) < 1e-9);
  // The scene follows the finger.
  assert.ok(turned.yaw < start.yaw && turned.pitch < start.pitch);

  await fingers(
    [
      [180, 300],
      [100, 300],
    ],
    [
      [220, 300],
      [300, 300],
    ],
  );
  const near = await camera();
  assert.ok(Math.abs(near.distance / turned.distance - 40 / 200) < 0.01, `${near.distance / turned.distance}`);
  assert.equal(near.yaw, turned.yaw);

  await fingers(
    [
      [150, 300],
      [210, 300],
    ],
    [
      [230, 300],
      [290, 300],
    ],
  );
  const moved = await camera();
  assert.ok(apart(moved.target, near.target) > 0.05 * near.distance);
  assert.ok(Math.abs(moved.distance / near.distance - 1) < 0.05);
  assert.equal(moved.yaw, near.yaw);
  assert.equal(moved.pitch, near.pitch);

  // Flying, one finger looks around, and two go forward.
  await tap("summary", isOpen);
  await tap("label.check", isFlying);
  await tap("summary", isFolded);
  const before = await camera();
  await fingers([
    [200, 300],
    [240, 300],
  ]);
  const looked = await camera();
  assert.ok(apart(looked.eye, before.eye) < 1e-6 * before.distance && looked.yaw !== before.yaw);
  await fingers(
    [
      [180, 300],
      [140, 300],
    ],
    [
      [220, 300],
      [260, 300],
    ],
  );
  const flown = await camera();
  assert.ok(Math.abs(flown.distance - looked.distance) < 1e-9);
  assert.ok(Math.abs(apart(flown.eye, looked.eye) / looked.distance - Math.log(3)) < 0.05);
  // Fingers that are gone do nothing.
  assert.equal(await page.evaluate(() => window.evogsViewer.controls.pointers.size), 0);
});

/** The share of the distance that a second of W goes. */
const FLY = 0.6;
const KEYBOARD = { viewport: { width: 660, height: 500 } };
const ORDER = [
  "view",
  "SUMMARY",
  "open",
  "url",
  "rate",
  "budget",
  "degree",
  "pause",
  "fit",
  "up",
  "link",
  "fly",
  "timeline",
];

/** What has the focus, and how that is seen. */
const focus = () =>
  page.evaluate(() => {
    const { activeElement } = document;
    const { outlineStyle, outlineWidth } = getComputedStyle(activeElement);
    const isSeen = outlineStyle !== "none" && Number.parseFloat(outlineWidth) >= 2;
    return { id: activeElement.id || activeElement.tagName, isSeen };
  });

/** Tabs to a control. */
async function tabTo(id) {
  for (let k = 0; k < 2 * ORDER.length; k++) {
    if ((await focus()).id === id) return;
    await page.keyboard.press("Tab");
  }
  throw new Error(`Tab does not come to ${id}`);
}

onDevice(
  "the keyboard alone: every control is reached in order, named, and seen to have the focus",
  KEYBOARD,
  async () => {
    await open(server.url("small.evogs"));
    await until(page, isDone, "the end");
    const found = [];
    for (let k = 0; k < ORDER.length; k++) {
      await page.keyboard.press("Tab");
      const { id, isSeen } = await focus();
      assert.ok(isSeen, `${id} has the focus, which is not seen`);
      found.push(id);
    }
    assert.deepEqual(found, ORDER);
    const session = await context.newCDPSession(page);
    const { nodes } = await session.send("Accessibility.getFullAXTree");
    const propertyOf = (node, name) => node.properties?.find((property) => property.name === name)?.value.value;
    const controls = nodes.filter(
      (node) => !node.ignored && propertyOf(node, "focusable") && node.role.value !== "RootWebArea",
    );
    assert.ok(controls.length >= ORDER.length);
    for (const { role, name } of controls) assert.ok(name?.value, `a ${role.value} has no name`);
    const sliders = await page.$$eval("input[type=range]", (all) =>
      all.map((slider) => slider.getAttribute("aria-valuetext")),
    );
    assert.deepEqual(sliders.slice(0, 3), ["no limit", "all", "3"]);
    assert.match(sliders[3], /kB of .* kB/);
  },
);

onDevice("the keyboard alone: a scene is opened, looked at, held up and looked back at", KEYBOARD, async () => {
  // In many pieces, of which the past has some.
  server.bytesPerSecond = 50000;
  await open(`http://127.0.0.1:${server.port}/`);
  await tabTo("url");
  await page.keyboard.type("small.evogs");
  await page.keyboard.press("Enter");
  await until(page, isDone, "the end");

  await tabTo("view");
  await until(page, ({ isSettled }) => isSettled, "rest");
  const start = await camera();
  await hold(page, "ArrowLeft");
  const turned = await camera();
  assert.ok(turned.yaw !== start.yaw && apart(turned.target, start.target) < 1e-9);
  await page.keyboard.press("=");
  assert.ok((await camera()).distance < start.distance);
  await page.keyboard.press("-");
  assert.ok(Math.abs((await camera()).distance - start.distance) < 1e-9);
  // How far it goes depends on the frames that the key was held for: under load they may be few, and short.
  await page.evaluate(() => {
    const { controls } = window.evogsViewer;
    const step = controls.step.bind(controls);
    window.held = 0;
    controls.step = (seconds) => {
      const isHeld = step(seconds);
      if (isHeld) window.held += seconds;
      return isHeld;
    };
  });
  await hold(page, "w");
  const held = await page.evaluate(() => window.held);
  const way = apart((await camera()).target, start.target) / start.distance;
  assert.ok(held > 0 && Math.abs(way / held - FLY) < 1e-6, `${way} in ${held} s`);
  await page.keyboard.press("f"); // frames the scene, wherever its default camera stands
  const fitted = await camera();
  await hold(page, "w");
  assert.ok(apart((await camera()).target, fitted.target) > 1e-6 * fitted.distance);
  await page.keyboard.press("f");
  assert.ok(apart((await camera()).target, fitted.target) < 1e-9);

  await tabTo("degree");
  await page.keyboard.press("ArrowLeft");
  assert.equal(await page.textContent("#degree-value"), "2");
  await tabTo("pause");
  await page.keyboard.press("Space");
  assert.equal(await page.getAttribute("#pause", "aria-pressed"), "true");
  await page.keyboard.press("Space");
  await tabTo("fly");
  await page.keyboard.press("Space");
  assert.ok(await page.isChecked("#fly"));
  await tabTo("timeline");
  await page.keyboard.press("Home");
  await until(page, ({ progress }) => progress.splats < 1000, "the past");
  await page.keyboard.press("End");
  await until(page, ({ progress }) => progress.splats === 1000, "the present");
  await tabTo("SUMMARY");
  await page.keyboard.press("Enter");
  assert.ok(!(await page.isVisible("#rate")));
  assert.equal((await stateOf(page)).notice, "");
});
