/** Decoding of whole scenes to float arrays: this decoder, the compiled one in Python, and @adobe/spz. */

import createSpz from "@adobe/spz";
import { spawn } from "node:child_process";
import { existsSync, readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { decode, floatView } from "evogs";

const ROOT = fileURLToPath(new URL("../../../", import.meta.url));
const TURNS = 15;

/** Seconds of the wall and of the processor, all threads of this process. */
function timed(run) {
  globalThis.gc?.();
  const cpu = process.cpuUsage();
  const wall = process.hrtime.bigint();
  const splats = run();
  const wallSeconds = Number(process.hrtime.bigint() - wall) / 1e9;
  const { user, system } = process.cpuUsage(cpu);
  return { splats, wall: wallSeconds, cpu: (user + system) / 1e6 };
}

/** A process that decodes what it is told of. */
function pythonDecoder() {
  const venv = `${ROOT}.venv/bin/python`;
  const python = process.env.EVOGS_PYTHON ?? (existsSync(venv) ? venv : "python3");
  const env = { ...process.env, PYTHONPATH: ROOT, NUMBA_NUM_THREADS: "1" };
  const script = fileURLToPath(new URL("decode.py", import.meta.url));
  const child = spawn(python, [script], { env, stdio: ["pipe", "pipe", "inherit"] });
  const lines = createInterface({ input: child.stdout })[Symbol.asyncIterator]();
  return {
    async decode(path) {
      child.stdin.write(`${path}\n`);
      return JSON.parse((await lines.next()).value);
    },
    end: () => child.stdin.end(),
  };
}

const median = (numbers) => numbers.toSorted((a, b) => a - b)[numbers.length >> 1];

/** Rows of the table: median milliseconds of turns that all contenders of a scene take one after the other. */
export async function decoding(scenes) {
  const spz = await createSpz({ print: () => {} });
  const python = pythonDecoder();
  const rows = [];
  for (const { name, stream, spzFile } of scenes) {
    const bytes = readFileSync(stream);
    const contenders = {
      evogs: () => timed(() => floatView(decode(bytes))[0].length),
      python: () => python.decode(stream),
    };
    if (spzFile) {
      const packed = new Uint8Array(readFileSync(spzFile));
      contenders.spz = () => timed(() => loadSpz(spz, packed));
    }
    const times = Object.fromEntries(Object.keys(contenders).map((key) => [key, []]));
    let first = 0;
    for (let turn = 0; turn <= TURNS; turn++) {
      for (const [key, run] of Object.entries(contenders)) {
        const took = await run();
        if (turn > 0) times[key].push(took);
        else if (key === "evogs") first = 1000 * took.wall;
      }
    }
    const of = (key, clock) => (times[key] ? 1000 * median(times[key].map((took) => took[clock])) : Number.NaN);
    rows.push({
      scene: name,
      splats: times.evogs[0].splats,
      bytes: bytes.length,
      first,
      evogs: of("evogs", "wall"),
      python: of("python", "wall"),
      spz: of("spz", "wall"),
      evogsCpu: of("evogs", "cpu"),
      pythonCpu: of("python", "cpu"),
      spzCpu: of("spz", "cpu"),
    });
  }
  python.end();
  return rows;
}

/** All float arrays of a file: each is a copy, of which the module keeps none. */
function loadSpz(spz, bytes) {
  const cloud = spz.loadSpzFromBuffer(bytes, { to: spz.CoordinateSystem.UNSPECIFIED });
  const { positions, scales, rotations, alphas, colors, sh } = cloud;
  cloud.delete?.();
  if (sh.length + scales.length + rotations.length + alphas.length + colors.length === 0) throw new Error("empty");
  return positions.length / 3;
}
