// node spark_draw.mjs NODE_MODULES VIEWS.json OUT FILE...: files of splats as Spark shows them.
// VIEWS.json: width, height, fovY in degrees, and views with eye, target and up, in the axes of a
// .ply. OUT.I.J.rgb gets view J of file I, as bytes, row by row from the top.
import { existsSync, readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [modules, views, out, ...files] = process.argv.slice(2);
const { chromium } = await import(pathToFileURL(`${modules}/playwright-core/index.mjs`).href);
const ARGUMENTS = [
  "--no-sandbox",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--ignore-gpu-blocklist",
  "--disable-dev-shm-usage",
];
const IMPORTS = { three: "/m/three/build/three.module.js", "three/addons/": "/m/three/examples/jsm/" };
const PAGE = `<script type="importmap">${JSON.stringify({ imports: IMPORTS })}</script><canvas id="c"></canvas>`;

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ARGUMENTS });
const page = await browser.newPage();
const failed = [];
page.on("pageerror", (error) => failed.push(error.message));
await page.route("http://peers.test/**", (route) => {
  const path = new URL(route.request().url()).pathname;
  if (path === "/") return route.fulfill({ contentType: "text/html", body: PAGE });
  const file = path.startsWith("/m/") ? `${modules}/${path.slice(3)}` : files[Number(path.slice(3))];
  if (!existsSync(file)) return route.fulfill({ status: 404 });
  const contentType = file.endsWith("js") ? "text/javascript" : "application/octet-stream";
  return route.fulfill({ contentType, body: readFileSync(file) });
});
await page.goto("http://peers.test/");

/** In the page: the pictures of a file, base64 of RGBA from the bottom up. */
async function draw([url, fileName, { width, height, fovY, views }]) {
  const THREE = await import("three");
  const { SparkRenderer, SplatMesh } = await import("/m/@sparkjsdev/spark/dist/spark.module.js");
  const canvas = document.getElementById("c");
  const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
  renderer.setPixelRatio(1);
  renderer.setSize(width, height, false);
  const spark = new SparkRenderer({
    renderer, accumExtSplats: true, maxStdDev: 3.4, preBlurAmount: 0.3, blurAmount: 0, sortRadial: false,
  });
  const fileBytes = new Uint8Array(await (await fetch(url)).arrayBuffer());
  const mesh = new SplatMesh({ fileBytes, fileName, extSplats: true });
  await mesh.initialized;
  if (fileName.endsWith(".spz")) mesh.quaternion.set(1, 0, 0, 0); // RUB, the axes of the format
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0, 0, 0);
  scene.add(spark, mesh);
  const pictures = [];
  for (const { eye, target, up } of views) {
    const camera = new THREE.PerspectiveCamera(fovY, width / height, 0.05, 1000);
    camera.position.set(...eye);
    camera.up.set(...up);
    camera.lookAt(...target);
    for (let frame = 0; frame < 8; frame++) {
      renderer.render(scene, camera);
      for (let wait = 0; wait < 2 || spark.sorting || spark.sortDirty; wait++) await new Promise((go) => setTimeout(go, 50));
    }
    const gl = renderer.getContext();
    const data = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, data);
    let text = "";
    for (const byte of data) text += String.fromCharCode(byte);
    pictures.push(btoa(text));
  }
  renderer.dispose();
  return pictures;
}

const look = JSON.parse(readFileSync(views, "utf8"));
try {
  for (const [i, file] of files.entries()) {
    const pictures = await page.evaluate(draw, [`/f/${i}`, file.split("/").at(-1), look]);
    for (const [j, text] of pictures.entries()) {
      const rgba = Buffer.from(text, "base64");
      const rgb = Buffer.alloc(3 * look.width * look.height);
      for (let y = 0; y < look.height; y++)
        for (let x = 0; x < look.width; x++)
          rgba.copy(rgb, 3 * (y * look.width + x), 4 * ((look.height - 1 - y) * look.width + x), 4 * ((look.height - 1 - y) * look.width + x) + 3);
      writeFileSync(`${out}.${i}.${j}.rgb`, rgb);
    }
  }
  if (failed.length > 0) throw new Error(failed.join("; "));
} finally {
  await browser.close();
}
