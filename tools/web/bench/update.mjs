/** What an update of 2,048 splats costs: texels of them, and their way to the GPU. */

import { readFileSync } from "node:fs";
import { CORE, decode } from "evogs";
import { TexelWriter } from "evogs-three/texels";
import { findChromium, launch } from "../viewer/test/browser.mjs";
import { PageServer } from "../viewer/test/server.mjs";

const SPLATS = 2048;
const TURNS = 200;

export async function updates(scenes) {
  const rows = [];
  for (const { name, stream } of scenes) {
    const scene = decode(readFileSync(stream));
    const writer = new TexelWriter(scene);
    writer.writeAll();
    const { shDegree } = scene.directory.header;
    const core = texelsOf(writer, [CORE]);
    const all = texelsOf(writer, [...Array(shDegree + 1).keys()]);
    const row = { scene: name, "SH degree": shDegree, "texels of core": core.ms, "and of SH": all.ms };
    const uploads = await uploadsOf(writer.layout, core.updates, all.updates);
    rows.push({ ...row, "to the GPU, core": uploads[0], "and SH": uploads[1] });
  }
  return rows;
}

function texelsOf(writer, components) {
  const changes = components.map((component) => ({ tile: 0, component, ranges: [{ start: 0, count: SPLATS }] }));
  let updates;
  const run = () => {
    for (let turn = 0; turn < TURNS; turn++) updates = writer.write(changes);
  };
  run();
  const start = process.cpuUsage();
  run();
  const { user, system } = process.cpuUsage(start);
  return { ms: (user + system) / 1000 / TURNS, updates };
}

/** Milliseconds of the page's main thread. NaN without Chromium. */
async function uploadsOf(layout, ...sets) {
  if (findChromium() === null) return sets.map(() => Number.NaN);
  const server = new PageServer();
  await server.start();
  const browser = await launch();
  try {
    const page = await browser.newPage({ viewport: { width: 320, height: 240 } });
    await page.goto(`http://127.0.0.1:${server.port}/`);
    await page.waitForFunction(() => window.evogsViewer !== undefined);
    const plain = sets.map((updates) => updates.map((update) => ({ ...update, data: Array.from(update.data) })));
    return await page.evaluate(
      async ({ layout, sets, turns, splats }) => {
        const { renderer } = window.evogsViewer;
        renderer.open(layout);
        const found = [];
        for (const set of sets) {
          const updates = set.map((update) => ({ ...update, data: Uint32Array.from(update.data) }));
          const times = [];
          for (let turn = 0; turn < turns; turn++) {
            // A batch, since clocks of browsers are coarse.
            const start = performance.now();
            for (let k = 0; k < 10; k++) renderer.update(updates, splats);
            times.push((performance.now() - start) / 10);
            await new Promise((resolve) => setTimeout(resolve, 5));
          }
          found.push(times.sort((a, b) => a - b)[times.length >> 1]);
        }
        return found;
      },
      { layout, sets: plain, turns: TURNS / 10, splats: SPLATS },
    );
  } finally {
    await browser.close();
    await server.stop();
  }
}
