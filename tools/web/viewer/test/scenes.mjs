/** The scenes of the tests, made by the project's own encoder, and pictures of them by its rasterizer. */

import { execFileSync } from "node:child_process";
import { existsSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { fileURLToPath, pathToFileURL } from "node:url";

const ROOT = fileURLToPath(new URL("../../../../", import.meta.url));
const FOLDER = `${ROOT}build/web-test`;
const VENV = `${ROOT}.venv/bin/python`;
export const PYTHON = process.env.EVOGS_PYTHON ?? (existsSync(VENV) ? VENV : "python3");

export function python(...parameters) {
  const options = { cwd: ROOT, env: { ...process.env, PYTHONPATH: ROOT }, stdio: ["ignore", "pipe", "pipe"] };
  return execFileSync(PYTHON, parameters.map(String), options).toString();
}

/** Whether the codec runs: null, or the reason why it does not. */
export function whyNoCodec() {
  if (existsSync(`${FOLDER}/scenes.made`)) return null;
  try {
    python("-c", "import evogs_codec, numba");
    return null;
  } catch {
    return `${PYTHON} has no evogs with its renderer: make venv, or EVOGS_PYTHON=...`;
  }
}

/** Runs commands of `evogs` one after the other, in one process: it takes a second to start. */
function evogs(...commands) {
  const words = JSON.stringify(commands.map((command) => command.map(String)));
  python("-c", RUN, words);
}

const RUN = `
import json, sys
from evogs_codec.cli.commands import main
for words in json.loads(sys.argv[1]):
    if main(words) != 0:
        sys.exit(f"evogs {' '.join(words)} failed")
`;

/** Makes what is not there yet. Of files of tests that want it at the same time one makes it, and the others wait. */
function once(name, make) {
  mkdirSync(FOLDER, { recursive: true });
  const made = `${FOLDER}/${name}.made`;
  const lock = `${FOLDER}/${name}.lock`;
  while (!existsSync(made)) {
    try {
      writeFileSync(lock, String(process.pid), { flag: "wx" });
    } catch {
      if (!isHeld(lock)) rmSync(lock, { force: true });
      Atomics.wait(new Int32Array(new SharedArrayBuffer(4)), 0, 0, 100);
      continue;
    }
    try {
      if (!existsSync(made)) make();
      writeFileSync(made, "");
    } finally {
      rmSync(lock);
    }
  }
}

/** Whether the process that took a lock runs. One that was killed left it behind. */
function isHeld(lock) {
  try {
    const pid = Number(readFileSync(lock, "utf8"));
    return pid === 0 || process.kill(pid, 0);
  } catch {
    return false;
  }
}

const SCENES = ["sh3", "sh1", "small", "five", "tiles", "default", "camera"];

/**
 * 8,000 splats in 7 levels at fixed steps, of SH degree 3 and 1, and in 8 tiles; and as the default has them. 1,000 for
 * tests of the page beside the picture: software draws them in a quarter of the time.
 * 24,000 as the default has them: 5 % of their bytes have the first splats. One with a default camera. Made once.
 * So they do of 8,000 splats with 7 levels, but then the second level is no better than the first.
 */
export function makeScenes() {
  const at = (name) => `${FOLDER}/${name}`;
  const encode = (from, to, ...options) => ["encode", at(`${from}.ply`), at(`${to}.evogs`), "--force", ...options];
  once("scenes", () => {
    makeDemo(at("small.ply"), 1000);
    makeDemo(at("scene.ply"), 8000);
    makeDemo(at("larger.ply"), 24000);
    evogs(
      encode("small", "small", "--levels", 4, "--preset", "scene", "--fast"),
      encode("small", "camera", "--preset", "scene", "--fast", "--camera", at("cameras.json"), "--view", 2),
      encode("scene", "sh3", "--levels", 7, "--preset", "scene"),
      ["extract", at("sh3.evogs"), at("sh1.evogs"), "--force", "--sh-degree", 1],
      encode("scene", "tiles", "--levels", 7, "--preset", "scene", "--tiles", 8),
      encode("scene", "five"),
      encode("larger", "default"),
    );
  });
  return Object.fromEntries(SCENES.map((name) => [name, readFileSync(at(`${name}.evogs`))]));
}

/** The files of a tileset, by their names: of the 8,000 splats in four, or of the 24,000 in two. */
export function makeTileset(scene = "scene", perFile = 2500) {
  const folder = `${FOLDER}/city-${scene}`;
  once(`city-${scene}`, () => {
    rmSync(folder, { recursive: true, force: true });
    const options = ["--per-file", perFile, "--overview", 1500, "--levels", 3, "--engine", "serial", "--fast"];
    evogs(["tileset", `${FOLDER}/${scene}.ply`, folder, ...options]);
  });
  const names = readdirSync(folder, { recursive: true }).filter((name) => /\.(json|evogs)$/.test(name));
  return Object.fromEntries(names.map((name) => [`city/${name}`, readFileSync(`${folder}/${name}`)]));
}

/** The scene that ships with the project; its cameras do not depend on the number of splats. */
function makeDemo(path, splats) {
  const module = "evogs_codec.render.demo_scene";
  python("-m", module, path, "--splats", splats, "--cameras", `${FOLDER}/cameras.json`);
}

/** Pictures of the first `sizes` bytes of a scene, and the camera that they were taken with. */
export function references(name, sizes) {
  const key = `${name}-${sizes.join("-")}`;
  const folder = `${FOLDER}/${key}`;
  once(key, () => {
    const script = fileURLToPath(new URL("reference.py", import.meta.url));
    python(script, `${FOLDER}/${name}.evogs`, `${FOLDER}/cameras.json`, folder, ...sizes);
  });
  return {
    pose: JSON.parse(readFileSync(`${folder}/camera.json`, "utf8")),
    pictures: sizes.map((size) => readFileSync(`${folder}/${size}.rgb`)),
  };
}

/** The address of a page of `evogs export-html`. */
export function exportedPage(name) {
  evogs(["export-html", scenePath(name), `${FOLDER}/${name}.html`]);
  return pathToFileURL(`${FOLDER}/${name}.html`).href;
}

export const scenePath = (name) => `${FOLDER}/${name}.evogs`;

/** The three splats of Annex A, for tests that only need some scene. */
export const exampleScene = () => readFileSync(`${ROOT}spec/example.evogs`);

/** A stream of the conformance suite whose directory is hostile: it must be refused. */
export function hostileDirectory() {
  return readFileSync(
    `${ROOT}conformance/vectors/invalid-directory/invalid-directory-amplification-sums-to-2-to-32.evogs`,
  );
}
