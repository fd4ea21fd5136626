/** The renderer Spark on three.js, which reads our textures. */

import { SparkRenderer, SplatMesh, type SplatMeshOptions, dyno } from "@sparkjsdev/spark";
import * as THREE from "three";
import { READ_BANDS, READ_CORE } from "./glsl.js";
import { type Layout, TEXELS } from "./layout.js";
import type { CameraPose, SplatRenderer } from "./renderer.js";
import type { TexelUpdate } from "./texels.js";

type SplatSource = NonNullable<SplatMeshOptions["splats"]>;

/** Where the alpha of the most opaque splat, 0.99, falls to 1/255 (spec/rasterizer.md). */
const MAX_STD_DEV = Math.sqrt(2 * Math.log(0.99 * 255));
/**
 * Splats are drawn however far aside their centres are, and however many pixels they cover: those of a sky are large.
 * Spark draws a wider one smaller.
 */
const WIDEST = 1e6;
/** Added to the variance of a footprint, in square pixels. */
const DILATION = 0.3;

export class SparkSplats implements SplatRenderer {
  onDirty = () => {};
  onLost = () => {};
  readonly maxTextureSize: number;
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera();
  private readonly spark: SparkRenderer;
  private mesh: SplatMesh | null = null;
  private source: TextureSource | null = null;

  /** Throws an Error if the browser has no WebGL2. */
  constructor(readonly canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
    this.renderer.setClearColor(0, 1);
    this.maxTextureSize = this.renderer.capabilities.maxTextureSize;
    this.spark = new SparkRenderer({
      renderer: this.renderer,
      onDirty: () => this.onDirty(),
      accumExtSplats: true,
      sortRadial: false,
      enableLod: false,
      maxStdDev: MAX_STD_DEV,
      maxPixelRadius: WIDEST,
      minAlpha: 1 / 255,
      clipXY: WIDEST,
    });
    boundSlopes(this.spark);
    this.scene.add(this.spark);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.onLost());
  }

  open(layout: Layout): void {
    this.close();
    // An antialiased scene loses opacity as its splats are dilated; others do not.
    this.spark.preBlurAmount = layout.isAntialiased ? 0 : DILATION;
    this.spark.blurAmount = layout.isAntialiased ? DILATION : 0;
    this.source = new TextureSource(this.renderer, layout);
    this.mesh = new SplatMesh({ splats: this.source, raycastable: false, editable: false });
    this.scene.add(this.mesh);
    this.onDirty();
  }

  update(updates: readonly TexelUpdate[], count: number): void {
    if (this.source === null) return;
    this.source.write(updates);
    this.source.count = count;
    this.mesh?.updateVersion();
    this.onDirty();
  }

  setShDegree(degree: number): void {
    if (this.source === null || this.source.maxSh.value === degree) return;
    this.source.maxSh.value = degree;
    this.mesh?.updateVersion();
    this.onDirty();
  }

  resize(width: number, height: number, pixelRatio: number): void {
    this.renderer.setPixelRatio(pixelRatio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.onDirty();
  }

  draw(pose: CameraPose): void {
    const { camera } = this;
    const [right, up, back] = pose.rotation;
    const [x, y, z] = pose.eye;
    camera.matrixAutoUpdate = false;
    camera.matrix.makeBasis(new THREE.Vector3(...right), new THREE.Vector3(...up), new THREE.Vector3(...back));
    camera.matrix.setPosition(x, y, z);
    camera.matrixWorldNeedsUpdate = true;
    camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
    camera.fov = (pose.fovY * 180) / Math.PI;
    camera.near = pose.near;
    camera.far = pose.far;
    camera.updateProjectionMatrix();
    this.renderer.render(this.scene, camera);
  }

  get isSettled(): boolean {
    const { spark } = this;
    return !spark.sorting && !spark.sortDirty && spark.display === spark.current;
  }

  dispose(): void {
    this.close();
    this.renderer.dispose();
  }

  private close(): void {
    if (this.mesh !== null) this.scene.remove(this.mesh);
    this.mesh?.dispose();
    this.source?.dispose();
    this.mesh = null;
    this.source = null;
  }
}

/**
 * Bounds the slopes at which the projection is linearised to 1.3 times those of the picture (spec/rasterizer.md):
 * without it, splats far aside smear over the whole picture. Spark offers no option for it.
 */
function boundSlopes(spark: SparkRenderer): void {
  const { material } = spark;
  const plain = "vec2 J2 = -(J1 * viewCenter.xy) * invZ;";
  if (!material.vertexShader.includes(plain)) throw new Error("the shader of this version of Spark is not known");
  const bounded = `
    vec2 widest = 1.3 / vec2(projectionMatrix[0][0], projectionMatrix[1][1]);
    vec2 J2 = -J1 * clamp(viewCenter.xy * invZ, -widest, widest);`;
  material.vertexShader = material.vertexShader.replace(plain, bounded);
}

/** Textures that only their changed rows are written to. */
class TextureSource implements SplatSource {
  count = 0;
  readonly maxSh = new dyno.DynoInt({ value: 3 });
  private readonly textures: THREE.DataTexture[];

  constructor(
    private readonly renderer: THREE.WebGLRenderer,
    private readonly layout: Layout,
  ) {
    const { width, rows, shDegree } = layout;
    this.textures = TEXELS.slice(0, shDegree + 1).map((texels) => {
      const texture = new THREE.DataTexture(
        null,
        texels * width,
        rows,
        THREE.RGBAIntegerFormat,
        THREE.UnsignedIntType,
      );
      texture.internalFormat = "RGBA32UI";
      texture.unpackAlignment = 4;
      // Memory is taken, and is 0: no copy of it is kept here.
      texture.source.dataReady = false;
      texture.needsUpdate = true;
      return texture;
    });
  }

  write(updates: readonly TexelUpdate[]): void {
    const { renderer, textures } = this;
    const gl = renderer.getContext() as WebGL2RenderingContext;
    const { state } = renderer;
    for (const { texture, column, row, columns, rows, data } of updates) {
      renderer.initTexture(textures[texture]);
      const { __webglTexture } = renderer.properties.get(textures[texture]) as { __webglTexture: WebGLTexture };
      state.bindTexture(gl.TEXTURE_2D, __webglTexture);
      state.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
      state.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
      state.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
      const n = TEXELS[texture];
      const format = [gl.RGBA_INTEGER, gl.UNSIGNED_INT] as const;
      gl.texSubImage2D(gl.TEXTURE_2D, 0, n * column, row, n * columns, rows, ...format, data);
    }
    state.unbindTexture();
  }

  prepareFetchSplat(): void {}

  getNumSplats(): number {
    return this.count;
  }

  hasRgbDir(): boolean {
    return this.getNumSh() > 0;
  }

  getNumSh(): number {
    return Math.min(this.layout.shDegree, this.maxSh.value);
  }

  setMaxSh(): void {}

  /** Nothing asks for it: picking is off. */
  forEachSplat(): void {}

  dispose(): void {
    for (const texture of this.textures) texture.dispose();
  }

  fetchSplat({ index, viewOrigin }: Parameters<SplatSource["fetchSplat"]>[0]): dyno.DynoVal<typeof dyno.Gsplat> {
    const { width, shDegree } = this.layout;
    const [core, ...bands] = this.textures.map((value) => new dyno.DynoUsampler2D({ value }));
    const inputs = {
      index,
      viewOrigin,
      maxSh: this.maxSh,
      core,
      band1: bands[0],
      band2: bands[1],
      band3: bands[2],
    };
    const inTypes = {
      index: "int",
      viewOrigin: "vec3",
      maxSh: "int",
      core: "usampler2D",
      band1: "usampler2D",
      band2: "usampler2D",
      band3: "usampler2D",
    } as const;
    const node = new dyno.Dyno({
      inTypes,
      outTypes: { gsplat: dyno.Gsplat },
      inputs,
      globals: () => [dyno.defineGsplat, READ_CORE, ...READ_BANDS.slice(0, shDegree)],
      statements: ({ inputs: at, outputs: { gsplat: g } }) => {
        const lines = [
          `evogsCore(${at.core}, ${width}, ${at.index}, ${g}.center, ${g}.scales, ${g}.quaternion, ${g}.rgba);`,
          `${g}.index = ${at.index};`,
          `${g}.flags = ${g}.rgba.a > 0.0 ? GSPLAT_FLAG_ACTIVE : 0u;`,
        ];
        if (at.viewOrigin === undefined) return lines;
        for (let band = 1; band <= shDegree; band++) {
          const texture = [at.band1, at.band2, at.band3][band - 1];
          const direction = `normalize(${g}.center - ${at.viewOrigin})`;
          lines.push(
            `if (${at.maxSh} >= ${band}) ${g}.rgba.rgb += evogsBand${band}(${texture}, ${width}, ${at.index}, ${direction});`,
          );
        }
        return lines;
      },
    });
    return node.outputs.gsplat;
  }
}
