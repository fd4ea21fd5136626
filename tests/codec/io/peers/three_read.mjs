// node three_read.mjs NODE_MODULES FILE OUT.json: a file of splats as the loaders of three have it.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [modules, file, out] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${modules}/three/examples/jsm/loaders/${name}.js`).href);
const bytes = readFileSync(file);
const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
const LOADERS = { ply: "GaussianSplatPLYLoader", spz: "SPZLoader", splat: "SPLATLoader", ksplat: "KSPLATLoader" };

async function geometryOf() {
  const ending = file.split(".").at(-1);
  if (ending !== "glb") {
    const name = LOADERS[ending];
    return new (await load(name))[name]().parse(data);
  }
  const { GLTFLoader } = await load("GLTFLoader");
  const { GLTFGaussianSplatLoaderExtension } = await load("GLTFGaussianSplatLoaderExtension");
  const loader = new GLTFLoader().register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
  let found;
  (await loader.parseAsync(data, "")).scene.traverse((object) => {
    if (object.userData.gltfExtensions !== undefined) found = object;
  });
  return found.splatGeometry ?? found.geometry;
}

const geometry = await geometryOf();
const n = geometry.getAttribute("position").count;
const sh = Array.from({ length: n }, () => []);
for (let band = 1; geometry.getAttribute(`sphericalHarmonics${band}`) !== undefined; band++) {
  const words = geometry.getAttribute(`sphericalHarmonics${band}`);
  const packed = new Uint8Array(words.array.buffer);
  const stride = 4 * words.itemSize;
  for (let i = 0; i < n; i++)
    for (let j = 0; j < 3 * (2 * band + 1); j++) sh[i].push((packed[i * stride + j] - 128) / 128);
}
const list = (name) => Array.from(geometry.getAttribute(name).array);
writeFileSync(
  out,
  JSON.stringify({ means: list("position"), covariances: list("covariance"), rgba: list("color"), sh: sh.flat() }),
);
