/** Decodes the files that it is told of, for decode.mjs: a path a line, answered with seconds. As decode.py. */

import createSpz from "@adobe/spz";
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { decodeFloats } from "evogs";

const spz = process.argv[2] === "spz" ? await createSpz({ print: () => {} }) : null;

/** All float arrays of an SPZ file: each is a copy, of which the module keeps none. */
function loadSpz(bytes) {
  const cloud = spz.loadSpzFromBuffer(bytes, { to: spz.CoordinateSystem.UNSPECIFIED });
  const { positions, scales, rotations, alphas, colors, sh } = cloud;
  cloud.delete?.();
  return [positions, scales, rotations, alphas, colors, sh];
}

for await (const line of createInterface({ input: process.stdin })) {
  const bytes = new Uint8Array(readFileSync(line));
  const cpu = process.cpuUsage();
  const start = process.hrtime.bigint();
  const splats = spz === null ? decodeFloats(bytes)[0].length : loadSpz(bytes)[0].length / 3;
  const wall = Number(process.hrtime.bigint() - start) / 1e9;
  const { user, system } = process.cpuUsage(cpu);
  console.log(JSON.stringify({ splats, wall, cpu: (user + system) / 1e6 }));
}
