/** Decoding of whole scenes to float arrays: this decoder, the compiled one in Python, and @adobe/spz. */

import { spawn } from "node:child_process";
import { existsSync, statSync } from "node:fs";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";

const ROOT = fileURLToPath(new URL("../../../", import.meta.url));
const VENV = `${ROOT}.venv/bin/python`;
const PYTHON = process.env.EVOGS_PYTHON ?? (existsSync(VENV) ? VENV : "python3");
const TURNS = 21;

const script = (name) => fileURLToPath(new URL(name, import.meta.url));
const CONTENDERS = {
  evogs: [process.execPath, script("decoders.mjs"), "evogs"],
  python: [PYTHON, script("decode.py")],
  spz: [process.execPath, script("decoders.mjs"), "spz"],
};

/** A process of its own, so that memory that one frees serves no other. */
function start([command, ...parameters]) {
  const env = { ...process.env, PYTHONPATH: ROOT, NUMBA_NUM_THREADS: "1" };
  const child = spawn(command, parameters, { env, stdio: ["pipe", "pipe", "inherit"] });
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

/**
 * Median milliseconds of turns that all take one after the other, of the processor and of the wall, and the least
 * of the processor, which other programs disturb less.
 * `first` is that of a process that has decoded nothing before.
 */
export async function decoding(scenes) {
  const rows = [];
  for (const { name, stream, spzFile } of scenes) {
    const files = { evogs: stream, python: stream, ...(spzFile ? { spz: spzFile } : {}) };
    const times = Object.fromEntries(Object.keys(files).map((key) => [key, []]));
    const processes = Object.fromEntries(Object.keys(files).map((key) => [key, start(CONTENDERS[key])]));
    for (let turn = 0; turn <= TURNS; turn++) {
      for (const [key, file] of Object.entries(files)) times[key].push(await processes[key].decode(file));
    }
    for (const { end } of Object.values(processes)) end();
    const ms = (key, clock) =>
      times[key] ? 1000 * median(times[key].slice(1).map((took) => took[clock])) : Number.NaN;
    const row = { scene: name, splats: times.evogs[0].splats, bytes: statSync(stream).size };
    for (const clock of ["cpu", "wall"]) {
      for (const key of Object.keys(CONTENDERS)) row[`${key}, ${clock}`] = ms(key, clock);
    }
    const least = (key) => 1000 * Math.min(...(times[key] ?? []).slice(1).map(({ cpu }) => cpu));
    for (const key of Object.keys(CONTENDERS)) row[`${key}, least cpu`] = times[key] ? least(key) : Number.NaN;
    for (const clock of ["cpu", "least cpu"]) {
      row[`to python, ${clock}`] = row[`evogs, ${clock}`] / row[`python, ${clock}`];
      row[`to spz, ${clock}`] = row[`evogs, ${clock}`] / row[`spz, ${clock}`];
    }
    rows.push({
      ...row,
      "first, wall": 1000 * times.evogs[0].wall,
    });
  }
  return rows;
}
