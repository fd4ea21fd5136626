/** Where the page looks from: fitted to what came, by a link, and by keys. */

import assert from "node:assert/strict";
import { hold, picture, stateOf, until } from "./browser.mjs";
import { brightness, inBrowser, isDone, open, page, scenes, server } from "./page.mjs";

const look = () =>
  page.evaluate(() => {
    const { bounds, camera } = window.evogsViewer;
    const { eye, rotation, fovY } = camera.pose;
    return {
      radius: bounds?.radius,
      distance: camera.distance,
      up: [...camera.up],
      pose: [eye, rotation, fovY].flat(2),
    };
  });
const near = (a, b, what) =>
  a.forEach((x, i) => assert.ok(Math.abs(x - b[i]) < 1e-4 * (1 + Math.abs(b[i])), `${what}: ${a} is not ${b}`));
const openHere = async (name) => {
  await page.evaluate((name) => window.evogsViewer.open(name), name);
  return until(page, ({ state }) => state === "done" || state === "failed", name);
};
/** Another page, so that an address is opened anew where only its #view differs. */
const follow = async (address) => {
  await page.goto("about:blank");
  await page.goto(address);
  await page.waitForFunction(() => window.evogsViewer !== undefined);
  await until(page, isDone, address);
};

inBrowser("a scene that comes slowly is fitted as one that is there at once", async () => {
  await open("default.evogs");
  await until(page, isDone, "the end");
  const whole = await look();
  server.gate = Math.floor(0.06 * scenes.default.length);
  await open("default.evogs");
  await page.waitForFunction(() => window.evogsViewer.bounds !== null);
  const early = await look();
  assert.ok(Math.abs(early.radius / whole.radius - 1) > 0.01, `${early.radius}, then ${whole.radius}`);
  server.gate = Number.POSITIVE_INFINITY;
  await until(page, isDone, "the end");
  near((await look()).pose, whole.pose, "pose");
});

inBrowser("a view that was chosen by hand stays while a scene comes, and Fit knows all that came", async () => {
  server.gate = Math.floor(0.06 * scenes.default.length);
  await open("default.evogs");
  await page.waitForFunction(() => window.evogsViewer.bounds !== null);
  await page.mouse.move(290, 120);
  await page.mouse.wheel(0, -60);
  await page.waitForTimeout(100);
  const chosen = await look();
  server.gate = Number.POSITIVE_INFINITY;
  await until(page, isDone, "the end");
  const after = await look();
  assert.equal(after.distance, chosen.distance);
  assert.notEqual(after.radius, chosen.radius);
  await page.keyboard.press("f");
  const fitted = await look();
  assert.ok(Math.abs(fitted.distance / after.radius - chosen.distance / chosen.radius) > 0.01);
});

inBrowser("a copied link shows the same view: also its angle of view, and any up", async () => {
  await open("camera.evogs");
  await until(page, isDone, "the end");
  await page.click("summary");
  await page.click("#link");
  await page.waitForFunction(() => location.hash !== "");
  const first = await look();
  assert.ok(Math.abs(first.pose[first.pose.length - 1] - (50 * Math.PI) / 180) > 0.01);
  await follow(page.url());
  near((await look()).pose, first.pose, "the default camera");

  await open("small.evogs");
  await until(page, isDone, "the end");
  await page.evaluate(() => window.evogsViewer.setUp([0.3, -0.5, 0.8]));
  await page.click("summary");
  await page.click("#link");
  await page.waitForFunction(() => location.hash !== "");
  const tilted = await look();
  await follow(page.url());
  near((await look()).pose, tilted.pose, "a tilted up");
});

inBrowser("the up of an address comes before that of the scene", async () => {
  await follow(`${server.url("camera.evogs")}&up=-y`);
  assert.deepEqual((await look()).up, [0, -1, 0]);
});

inBrowser("the view of a link is that of its scene alone; a changed #view is taken", async () => {
  await follow(server.url("small.evogs"));
  const plain = await look();
  await follow(`${server.url("sh3.evogs")}&up=-y#view=1,2,3,4,0.5,0.5,30`);
  assert.equal((await look()).distance, 4);
  await openHere("small.evogs");
  near((await look()).pose, plain.pose, "the next scene");
  await page.evaluate(() => {
    location.hash = "view=0,0,0,20,1,-0.5";
  });
  await page.waitForFunction(() => window.evogsViewer.camera.distance === 20);
});

inBrowser("a scene that cannot be opened leaves nothing of the one before", async () => {
  await open("small.evogs");
  await until(page, isDone, "the end");
  assert.ok(brightness(await picture(page)) > 5);
  await openHere("missing.evogs");
  assert.equal(await page.textContent("#name"), "missing.evogs");
  assert.equal(brightness(await picture(page)), 0);
  await openHere("small.evogs");
  assert.ok(brightness(await picture(page)) > 5);
});

inBrowser("keys work at once, with Caps Lock, and at a checkbox", async () => {
  await open("small.evogs");
  await until(page, isDone, "the end");
  const target = () => page.evaluate(() => window.evogsViewer.camera.target.join());
  const before = await target();
  await hold(page, "w");
  assert.notEqual(await target(), before);
  const { up } = await look();
  await page.keyboard.press("U");
  const turned = (await look()).up;
  assert.notDeepEqual(turned, up);
  await page.click("summary");
  await page.focus("#fly");
  await page.keyboard.press("u");
  assert.notDeepEqual((await look()).up, turned);
  const typed = (await look()).up;
  await page.focus("#url");
  await page.keyboard.type("wup");
  assert.deepEqual((await look()).up, typed);
});

inBrowser("a link that cannot be copied is told to be in the address bar; names have no escapes", async () => {
  server.scenes.set("my%20scene.evogs", scenes.small);
  await page.addInitScript(() => Object.defineProperty(navigator, "clipboard", { value: undefined }));
  await open("my%20scene.evogs");
  await until(page, isDone, "the end");
  assert.equal(await page.textContent("#name"), "my scene.evogs");
  await page.click("summary");
  await page.click("#link");
  const { notice } = await until(page, ({ notice }) => notice !== "", "the link");
  assert.match(notice, /in the address bar/);
  assert.match(page.url(), /#view=/);
});

inBrowser("a window of another size is another view, and a lost context is told", async () => {
  await open("small.evogs");
  await until(page, isDone, "the end");
  await page.waitForTimeout(500);
  await page.evaluate(() => {
    const { worker } = window.evogsViewer;
    const post = worker.postMessage.bind(worker);
    window.views = 0;
    worker.postMessage = (message) => {
      if (message.kind === "view") window.views++;
      post(message);
    };
  });
  await page.setViewportSize({ width: 330, height: 300 });
  await page.waitForFunction(() => window.views === 1);
  await until(page, ({ isSettled }) => isSettled, "rest");
  await page.evaluate(() => {
    const gl = document.getElementById("view").getContext("webgl2");
    window.loss = gl.getExtension("WEBGL_lose_context");
    window.loss.loseContext();
  });
  await until(page, ({ notice }) => /graphics/.test(notice), "the notice");
  await page.evaluate(() => window.loss.restoreContext());
  await until(page, ({ notice }) => notice === "", "the end of it");
  assert.equal((await stateOf(page)).state, "done");
});
