// node gs3d.mjs NODE_MODULES FILE DEGREE OUT: a file of splats as gaussian-splats-3d has it.
// OUT.json gets the numbers; OUT.LEVEL.ksplat the file that the program writes.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [modules, file, degree, out] = process.argv.slice(2);
const program = `${modules}/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js`;
globalThis.window = globalThis; // where it looks for timers
const { KSplatLoader, PlyLoader, SplatLoader } = await import(pathToFileURL(program).href);
const bytes = readFileSync(file);
const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);

const [ending, level] = [file.split(".").at(-1), out.endsWith(".ksplat") ? Number(out.split(".").at(-2)) : 0];
const read = {
  ply: () => PlyLoader.loadFromFileData(data, 0, level, true, Number(degree)),
  splat: () => SplatLoader.loadFromFileData(data, 0, level, true),
  ksplat: () => KSplatLoader.loadFromFileData(data),
};
const splats = await read[ending]();
if (out.endsWith(".ksplat")) writeFileSync(out, new Uint8Array(splats.bufferData));
else {
  const n = splats.getSplatCount();
  const components = 3 * ((Number(degree) + 1) ** 2 - 1);
  const [means, covariances] = [new Float32Array(3 * n), new Float32Array(6 * n)];
  const [rgba, sh] = [new Uint8Array(4 * n), new Float32Array(components * n)];
  splats.fillSplatCenterArray(means);
  splats.fillSplatCovarianceArray(covariances, undefined, 0, n - 1, 0, 0);
  splats.fillSplatColorArray(rgba, 0);
  if (components) splats.fillSphericalHarmonicsArray(sh, Number(degree), undefined, 0, n - 1, 0, 0);
  const [low, high] = [splats.minSphericalHarmonicsCoeff, splats.maxSphericalHarmonicsCoeff];
  if (splats.compressionLevel === 2) // its shader makes numbers of the bytes
    for (const i of sh.keys()) sh[i] = (sh[i] / 255) * (high - low) + low;
  const lists = { means, covariances, rgba, sh };
  for (const name in lists) lists[name] = Array.from(lists[name]);
  writeFileSync(out, JSON.stringify(lists));
}
