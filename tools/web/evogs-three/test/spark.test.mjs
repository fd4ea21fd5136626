/** SparkSplats on a page of its own: the example of the README, sizes, lost contexts, and the end. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { core, stream } from "../../evogs/test/streams.mjs";
import { findChromium, launch } from "../../viewer/test/browser.mjs";

const skip = findChromium() === null ? "no Chromium: apt-get install chromium, or CHROMIUM=..." : false;
const KIT = 'export { Decoder } from "evogs"; export * from "evogs-three";';
const PAGE = `<!doctype html><style>canvas { width: 400px; height: 200px }</style><canvas></canvas>
  <script type="module" src="page.js"></script>`;

/** What the page loads, by its path. */
const files = new Map();
let server;
let browser;

before(async () => {
  if (skip) return;
  const [, example] = /```js\n(.*?)```/s.exec(readFileSync(new URL("../README.md", import.meta.url), "utf8"));
  files.set("/scene.evogs", scene());
  files.set("/kit.js", await bundle(KIT));
  files.set("/readme.js", await bundle(example));
  files.set("/readme.html", PAGE.replace("page.js", "readme.js"));
  files.set("/", PAGE.replace("page.js", "kit.js"));
  server = createServer(({ url }, response) => {
    const type = url.endsWith(".js") ? "text/javascript" : url.endsWith(".evogs") ? "model/evogs" : "text/html";
    const file = files.get(url);
    response.writeHead(file === undefined ? 404 : 200, { "Content-Type": type }).end(file);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  browser = await launch();
});

after(async () => {
  await browser?.close();
  server?.closeAllConnections();
  server?.close();
});

/** A row of 400 bright splats that are hard to see through, around the origin. */
function scene(n = 400) {
  // As the format has them: 2 x for x, and -2 x - 1 for a negative one.
  const all = (value) => Array.from({ length: n }, () => value);
  const places = Array.from({ length: n }, (_, k) => k % 9);
  const channels = [places, places, places, all(2), all(0), all(0), all(0), all(0), all(0), all(0), all(8)];
  const values = [...channels, all(4), all(4), all(4)];
  const adds = Object.fromEntries(values.map((list, k) => [21 + k, [0x08, list]]));
  return stream({ rows: [{ adds: n, bytes: core(adds) }] });
}

async function bundle(contents) {
  const resolveDir = fileURLToPath(new URL("..", import.meta.url));
  const options = { bundle: true, format: "esm", target: "es2022", write: false, logLevel: "warning" };
  const { outputFiles } = await build({ ...options, stdin: { contents, resolveDir } });
  return outputFiles[0].text;
}

/** A test on a page, that leaves no error there. */
function inBrowser(name, address, body, options = {}) {
  test(name, { skip, timeout: 120000 }, async () => {
    const page = await browser.newPage({ viewport: { width: 800, height: 600 }, ...options });
    const errors = [];
    page.on("pageerror", (error) => errors.push(String(error)));
    try {
      await page.addInitScript(counts);
      await page.goto(`http://127.0.0.1:${server.address().port}${address}`);
      await page.evaluate(helpers);
      await body(page);
      assert.deepEqual(errors, []);
    } finally {
      await page.close();
    }
  });
}

/** Counts workers that run, and listeners of canvases. */
function counts() {
  window.alive = { workers: 0, listeners: 0 };
  window.Worker = class extends Worker {
    constructor(...parameters) {
      super(...parameters);
      alive.workers++;
    }
    terminate() {
      super.terminate();
      alive.workers--;
    }
  };
  const { addEventListener, removeEventListener } = EventTarget.prototype;
  EventTarget.prototype.addEventListener = function (...parameters) {
    if (this instanceof HTMLCanvasElement) alive.listeners++;
    addEventListener.apply(this, parameters);
  };
  EventTarget.prototype.removeEventListener = function (...parameters) {
    if (this instanceof HTMLCanvasElement) alive.listeners--;
    removeEventListener.apply(this, parameters);
  };
}

/** What the tests do on the page. */
function helpers() {
  window.wait = async (holds, what, milliseconds = 0) => {
    for (const end = Date.now() + 20000; !holds(); ) {
      if (Date.now() > end) throw new Error(`${what} did not come true`);
      await new Promise((resolve) => setTimeout(resolve, milliseconds));
    }
  };
  /** Waits until the mean of the canvas is such; reading it takes long. */
  window.seen = (holds, what) => wait(() => holds(brightness()), what, 50);
  /** The mean of the canvas, of 255. */
  window.brightness = (canvas = document.querySelector("canvas")) => {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const context = copy.getContext("2d");
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, copy.width, copy.height);
    return data.reduce((sum, x, i) => sum + (i % 4 < 3 ? x : 0), 0) / (0.75 * data.length);
  };
  const back = [0, -0.9701, 0.2425];
  const rotation = [[1, 0, 0], [0, 0.2425, 0.9701], back];
  const poseAt = (far) => ({ eye: back.map((x) => far * x), rotation, fovY: 0.8, near: 0.1, far: 1000 });
  /** The scene in a canvas, drawn whenever it must. */
  window.show = async (canvas = document.querySelector("canvas"), isPart = false) => {
    const { Decoder, SparkSplats, TexelWriter } = await import("/kit.js");
    const decoder = new Decoder();
    decoder.put(0, new Uint8Array(await (await fetch("/scene.evogs")).arrayBuffer()));
    const writer = new TexelWriter(decoder.scene);
    const renderer = new SparkSplats(canvas);
    const shown = { renderer, contexts: [], losses: 0, far: 12, isDirty: true };
    const write = () => {
      if (isPart) {
        renderer.openParts();
        renderer.openPart(7, writer.layout, [0, 0, 0]);
        renderer.updatePart(7, writer.writeAll(), writer.count);
        renderer.showParts([7], [7]);
      } else {
        renderer.open(writer.layout);
        renderer.update(writer.writeAll(), writer.count);
      }
    };
    renderer.onDirty = () => {
      shown.isDirty = true;
    };
    renderer.onContext = (isLost) => shown.contexts.push(isLost);
    renderer.onLost = () => {
      shown.losses++;
      write();
    };
    const frame = () => {
      requestAnimationFrame(frame);
      if (!shown.isDirty) return;
      shown.isDirty = false;
      renderer.draw(poseAt(shown.far));
    };
    write();
    frame();
    shown.draws = 0;
    const draw = renderer.draw.bind(renderer);
    renderer.draw = (pose) => {
      shown.draws++;
      draw(pose);
    };
    shown.settled = () => wait(() => !shown.isDirty && renderer.isSettled, "a picture that is settled");
    shown.sorting = async () => {
      shown.far += 1;
      shown.isDirty = true;
      await wait(() => renderer.spark.sorting, "a sort");
    };
    return shown;
  };
}

inBrowser("the example of the README shows a scene in the size of its canvas", "/readme.html", async (page) => {
  await page.evaluate(() => seen((mean) => mean > 5, "a picture"));
  const sizeOf = () =>
    page.evaluate(() => {
      const { width, height } = document.querySelector("canvas");
      return [width, height];
    });
  assert.deepEqual(await sizeOf(), [400, 200]);
  await page.evaluate(() => {
    document.querySelector("canvas").style.width = "300px";
  });
  await page.waitForFunction(() => document.querySelector("canvas").width === 300);
  await page.evaluate(() => seen((mean) => mean > 5, "a picture of another size"));
  // The picture comes back when the GPU lost all.
  await page.evaluate(async () => {
    const canvas = document.querySelector("canvas");
    const context = canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
    const isLost = new Promise((resolve) => canvas.addEventListener("webglcontextlost", resolve, { once: true }));
    context.loseContext();
    await isLost;
    await seen((mean) => mean < 1, "an empty canvas");
    await new Promise((resolve) => setTimeout(resolve, 100));
    context.restoreContext();
    await seen((mean) => mean > 5, "the picture again");
  });
  assert.deepEqual(await sizeOf(), [300, 200]);
});

inBrowser(
  "without resize, a picture has the size and the shape of its canvas, on the page or not",
  "/",
  async (page) => {
    const found = await page.evaluate(async () => {
      const { renderer } = await show();
      const away = document.createElement("canvas");
      [away.width, away.height] = [90, 60];
      const other = await show(away);
      const plain = document.createElement("canvas");
      plain.style.cssText = "width: auto; height: auto";
      document.body.append(plain);
      const third = await show(plain);
      return [renderer, other.renderer, third.renderer].map(({ canvas, camera }) => [
        canvas.width,
        canvas.height,
        camera.aspect,
        canvas.clientWidth,
      ]);
    });
    // One that has no size of the page's does not grow with the pixels that it has.
    assert.deepEqual(found, [
      [400, 200, 2, 400],
      [90, 60, 1.5, 0],
      [300, 150, 2, 300],
    ]);
  },
  { deviceScaleFactor: 2 },
);

inBrowser("a move takes two pictures: at once, and when the splats are sorted for it", "/", async (page) => {
  const draws = await page.evaluate(async () => {
    const shown = await show();
    await shown.settled();
    shown.draws = 0;
    await shown.sorting();
    await shown.settled();
    return shown.draws;
  });
  assert.equal(draws, 2);
});

for (const isPart of [false, true]) {
  const what = isPart ? "parts" : "a scene";
  inBrowser(
    `the picture of ${what} comes back when the context was lost while splats were sorted`,
    "/",
    async (page) => {
      const found = await page.evaluate(async (isPart) => {
        const shown = await show(undefined, isPart);
        const { renderer } = shown;
        await shown.settled();
        const first = brightness();
        const context = renderer.canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
        await shown.sorting();
        context.loseContext();
        await wait(() => shown.contexts.length === 1, "the loss");
        const isSettled = renderer.isSettled;
        await new Promise((resolve) => setTimeout(resolve, 100));
        context.restoreContext();
        await wait(() => shown.losses === 1, "the new context");
        await shown.settled();
        const { contexts } = shown;
        const again = brightness();
        await shown.sorting();
        await shown.settled();
        return { first, again, last: brightness(), isSettled, contexts, workers: alive.workers };
      }, isPart);
      assert.ok(found.first > 5 && found.again > 0.5 * found.first && found.last > 5, JSON.stringify(found));
      assert.deepEqual(found.contexts, [true, false]);
      assert.equal(found.isSettled, false);
      assert.equal(found.workers, 1);
    },
  );
}

inBrowser(
  "the end leaves no worker, no listener and no context, whether splats are sorted or not",
  "/",
  async (page) => {
    const found = await page.evaluate(async () => {
      const left = [];
      for (const isSorting of [false, true, true]) {
        const canvas = document.createElement("canvas");
        document.body.append(canvas);
        const shown = await show(canvas);
        const gl = canvas.getContext("webgl2");
        // The last one ends in its first sort, which starts the worker.
        if (left.length < 2) await shown.settled();
        if (isSorting) await shown.sorting();
        shown.renderer.dispose();
        shown.isDirty = true;
        await new Promise((resolve) => setTimeout(resolve, 300));
        left.push([alive.workers, alive.listeners, gl.isContextLost(), shown.contexts.length]);
        canvas.remove();
      }
      return left;
    });
    const none = [0, 0, true, 0];
    assert.deepEqual(found, [none, none, none]);
  },
);
