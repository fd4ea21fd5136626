/** The renderer Spark on three.js, which reads our textures. */

import { SplatMesh, type SplatMeshOptions, dyno } from "@sparkjsdev/spark";
import * as THREE from "three";
import { READ_BANDS, READ_BETWEEN, READ_CORE } from "./glsl.js";
import { type Layout, SOURCES, TEXELS } from "./layout.js";
import { OwnSpark } from "./ownSpark.js";
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
/** Splats of a larger scene do not move: their states before would take as much memory again. */
const MOST_MOVING = 2 ** 21;
/** Added to the variance of a footprint, in square pixels. */
const DILATION = 0.3;

export class SparkSplats implements SplatRenderer {
  onDirty = () => {};
  onLost = () => {};
  onContext = (_isLost: boolean) => {};
  readonly maxTextureSize: number;
  /** Seconds by which splats move. */
  clock = () => performance.now() / 1000;
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera();
  private spark: OwnSpark;
  private mesh: SplatMesh | null = null;
  private source: TextureSource | null = null;
  private readonly parts = new Map<number, { mesh: SplatMesh; source: TextureSource }>();
  private isDrawing = false;
  /** When splats began to move, and for how long. */
  private motion = { start: 0, seconds: 0 };

  /** Its picture has the size of the canvas on the page until `resize`. Throws an Error if there is no WebGL2. */
  constructor(readonly canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
    this.renderer.setClearColor(0, 1);
    this.maxTextureSize = this.renderer.capabilities.maxTextureSize;
    this.spark = this.newSpark();
    const { clientWidth, clientHeight } = canvas;
    // A canvas that is not on the page keeps the size that it has.
    if (clientWidth > 0 && clientHeight > 0) this.resize(clientWidth, clientHeight, 1);
    else this.camera.aspect = canvas.width / canvas.height;
    canvas.addEventListener("webglcontextlost", this.lose);
    canvas.addEventListener("webglcontextrestored", this.restore);
  }

  open(layout: Layout): void {
    this.close();
    this.source = this.sourceOf(layout);
    this.mesh = new SplatMesh({ splats: this.source, raycastable: false, editable: false });
    this.scene.add(this.mesh);
    this.onDirty();
  }

  openParts(): void {
    this.close();
    this.onDirty();
  }

  openPart(part: number, layout: Layout, at: readonly [number, number, number]): void {
    const isVisible = this.parts.get(part)?.mesh.visible ?? false;
    this.closePart(part);
    const source = this.sourceOf(layout, false);
    const mesh = new SplatMesh({ splats: source, raycastable: false, editable: false });
    mesh.position.set(...at);
    mesh.visible = isVisible;
    this.parts.set(part, { mesh, source });
    this.scene.add(mesh);
    this.onDirty();
  }

  updatePart(part: number, updates: readonly TexelUpdate[], count: number): void {
    const found = this.parts.get(part);
    if (found === undefined) return;
    found.source.write(updates);
    found.source.count = count;
    found.mesh.updateVersion();
    this.onDirty();
  }

  showParts(shown: readonly number[], kept: readonly number[]): void {
    for (const [part, { mesh }] of [...this.parts]) {
      if (!kept.includes(part)) this.closePart(part);
      else mesh.visible = shown.includes(part);
    }
    this.onDirty();
  }

  update(updates: readonly TexelUpdate[], count: number, seconds = 0): void {
    if (this.source === null) return;
    this.source.write(updates);
    this.source.count = count;
    this.motion = { start: this.clock(), seconds: this.source.canMove ? seconds : 0 };
    this.source.time.value = this.time;
    this.mesh?.updateVersion();
    this.onDirty();
  }

  setShDegree(degree: number): void {
    const all = [...this.parts.values(), { mesh: this.mesh, source: this.source }];
    for (const { mesh, source } of all) {
      if (source === null || source.maxSh.value === degree) continue;
      source.maxSh.value = degree;
      mesh?.updateVersion();
      this.onDirty();
    }
  }

  resize(width: number, height: number, pixelRatio: number): void {
    this.renderer.setPixelRatio(pixelRatio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.onDirty();
  }

  draw(pose: CameraPose): void {
    if (this.isContextLost) return;
    const { camera } = this;
    this.move();
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
    this.isDrawing = true;
    try {
      this.renderer.render(this.scene, camera);
    } finally {
      this.isDrawing = false;
    }
  }

  get isMoving(): boolean {
    return this.source !== null && this.source.time.value < 1;
  }

  get isSettled(): boolean {
    const { spark, source } = this;
    const isThere = source === null || source.time.value === this.time;
    return !this.isContextLost && isThere && !spark.sorting && !spark.sortDirty && spark.display === spark.current;
  }

  dispose(): void {
    this.close();
    this.canvas.removeEventListener("webglcontextlost", this.lose);
    this.canvas.removeEventListener("webglcontextrestored", this.restore);
    this.spark.dispose();
    this.renderer.dispose();
    // Browsers have few contexts, and free one only when its canvas is collected.
    this.renderer.forceContextLoss();
  }

  private readonly lose = (event: Event): void => {
    event.preventDefault();
    this.onContext(true);
  };

  private readonly restore = (): void => {
    const { preBlurAmount, blurAmount } = this.spark;
    this.scene.remove(this.spark);
    this.spark.dispose();
    this.spark = this.newSpark();
    Object.assign(this.spark, { preBlurAmount, blurAmount });
    this.onContext(false);
    this.onLost();
    this.onDirty();
  };

  private get isContextLost(): boolean {
    return this.renderer.getContext().isContextLost();
  }

  private newSpark(): OwnSpark {
    const spark = new OwnSpark({
      renderer: this.renderer,
      // What a picture finds new is in it; the order of its splats comes later.
      onDirty: () => {
        if (!this.isDrawing) this.onDirty();
      },
      accumExtSplats: true,
      sortRadial: false,
      enableLod: false,
      maxStdDev: MAX_STD_DEV,
      maxPixelRadius: WIDEST,
      minAlpha: 1 / 255,
      clipXY: WIDEST,
    });
    this.scene.add(spark);
    return spark;
  }

  /** How far splats have moved from their states before: 1 at the end. */
  private get time(): number {
    const { start, seconds } = this.motion;
    return seconds > 0 ? Math.min(1, Math.max(0, (this.clock() - start) / seconds)) : 1;
  }

  /** Moves splats to where they are now. */
  private move(): void {
    const { source, time } = this;
    if (source === null) return;
    if (source.time.value !== time) {
      source.time.value = time;
      this.mesh?.updateVersion();
    }
    if (time === 1) source.settle();
  }

  /** The textures of a scene, whose splats are drawn as it says. */
  private sourceOf(layout: Layout, canMove = true): TextureSource {
    // An antialiased scene loses opacity as its splats are dilated; others do not.
    this.spark.preBlurAmount = layout.isAntialiased ? 0 : DILATION;
    this.spark.blurAmount = layout.isAntialiased ? DILATION : 0;
    return new TextureSource(this.renderer, layout, canMove);
  }

  private closePart(part: number): void {
    const found = this.parts.get(part);
    if (found === undefined) return;
    this.parts.delete(part);
    this.scene.remove(found.mesh);
    found.mesh.dispose();
    found.source.dispose();
  }

  private close(): void {
    for (const part of [...this.parts.keys()]) this.closePart(part);
    if (this.mesh !== null) this.scene.remove(this.mesh);
    this.mesh?.dispose();
    this.source?.dispose();
    this.mesh = null;
    this.source = null;
    this.motion = { start: 0, seconds: 0 };
  }
}

/** Textures that only their changed rows are written to: of the last states, and of those before. */
class TextureSource implements SplatSource {
  count = 0;
  readonly maxSh = new dyno.DynoInt({ value: 3 });
  /** From the states before to the last ones. */
  readonly time = new dyno.DynoFloat({ value: 1 });
  readonly canMove: boolean;
  private readonly after: THREE.DataTexture[];
  private readonly before: THREE.DataTexture[];
  private readonly sources: THREE.DataTexture;
  /** What the states before lack. */
  private last: readonly TexelUpdate[] = [];

  constructor(
    private readonly renderer: THREE.WebGLRenderer,
    private readonly layout: Layout,
    canMove: boolean,
  ) {
    const texels = TEXELS.slice(0, layout.shDegree + 1);
    this.after = texels.map((n) => newTexture(layout, n, "RGBA32UI"));
    this.canMove = canMove && layout.width * layout.rows <= MOST_MOVING;
    this.before = this.canMove ? texels.map((n) => newTexture(layout, n, "RGBA32UI")) : this.after;
    this.sources = newTexture(this.canMove ? layout : { ...layout, rows: 1 }, 1, "R32UI");
  }

  write(updates: readonly TexelUpdate[]): void {
    this.settle();
    for (const update of updates) {
      if (update.texture !== SOURCES) this.upload(this.after[update.texture], update);
      else if (this.canMove) this.upload(this.sources, update);
    }
    if (this.canMove) this.last = updates;
    this.renderer.state.unbindTexture();
  }

  /** Makes the last states those before the next ones. */
  settle(): void {
    if (this.last.length === 0) return;
    for (const update of this.last) {
      if (update.texture !== SOURCES) this.upload(this.before[update.texture], update);
      else this.upload(this.sources, { ...update, data: new Uint32Array(update.data.length) });
    }
    this.last = [];
    this.renderer.state.unbindTexture();
  }

  private upload(
    texture: THREE.DataTexture,
    { column, row, columns, rows, data, texture: kind }: TexelUpdate,
  ): void {
    const { renderer } = this;
    const gl = renderer.getContext() as WebGL2RenderingContext;
    const { state } = renderer;
    renderer.initTexture(texture);
    const { __webglTexture } = renderer.properties.get(texture) as { __webglTexture: WebGLTexture };
    state.bindTexture(gl.TEXTURE_2D, __webglTexture);
    state.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    state.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    state.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    const n = kind === SOURCES ? 1 : TEXELS[kind];
    const format = kind === SOURCES ? gl.RED_INTEGER : gl.RGBA_INTEGER;
    gl.texSubImage2D(gl.TEXTURE_2D, 0, n * column, row, n * columns, rows, format, gl.UNSIGNED_INT, data);
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
    for (const texture of [...this.after, ...this.before, this.sources]) texture.dispose();
  }

  fetchSplat({ index, viewOrigin }: Parameters<SplatSource["fetchSplat"]>[0]): dyno.DynoVal<typeof dyno.Gsplat> {
    const { width, shDegree } = this.layout;
    const [core, ...bands] = this.after.map((value) => new dyno.DynoUsampler2D({ value }));
    const [core0, ...bands0] = this.before.map((value) => new dyno.DynoUsampler2D({ value }));
    const inputs = {
      index,
      viewOrigin,
      maxSh: this.maxSh,
      time: this.time,
      sources: new dyno.DynoUsampler2D({ value: this.sources }),
      core,
      band1: bands[0],
      band2: bands[1],
      band3: bands[2],
      core0,
      band10: bands0[0],
      band20: bands0[1],
      band30: bands0[2],
    };
    const inTypes = {
      index: "int",
      viewOrigin: "vec3",
      maxSh: "int",
      time: "float",
      sources: "usampler2D",
      core: "usampler2D",
      band1: "usampler2D",
      band2: "usampler2D",
      band3: "usampler2D",
      core0: "usampler2D",
      band10: "usampler2D",
      band20: "usampler2D",
      band30: "usampler2D",
    } as const;
    const node = new dyno.Dyno({
      inTypes,
      outTypes: { gsplat: dyno.Gsplat },
      inputs,
      globals: () => [dyno.defineGsplat, READ_CORE, READ_BETWEEN, ...READ_BANDS.slice(0, shDegree)],
      statements: ({ inputs: at, outputs: { gsplat: g } }) => {
        const splat = `${g}.center, ${g}.scales, ${g}.quaternion, ${g}.rgba`;
        const lines = [
          "{",
          "float part = 1.0;",
          "int from = 0;",
          `evogsCore(${at.core}, ${width}, ${at.index}, ${splat});`,
          `if (${at.time} < 1.0) evogsBetween(${at.core0}, ${at.sources}, ${width}, ${at.index}, ${at.time}, ${splat}, part, from);`,
          `${g}.index = ${at.index};`,
          `${g}.flags = ${g}.rgba.a > 0.0 ? GSPLAT_FLAG_ACTIVE : 0u;`,
        ];
        if (at.viewOrigin === undefined) return [...lines, "}"];
        lines.push(`vec3 direction = normalize(${g}.center - ${at.viewOrigin});`);
        for (let band = 1; band <= shDegree; band++) {
          const after = [at.band1, at.band2, at.band3][band - 1];
          const before = [at.band10, at.band20, at.band30][band - 1];
          lines.push(
            `if (${at.maxSh} >= ${band}) {`,
            `  vec3 colour = evogsBand${band}(${after}, ${width}, ${at.index}, direction);`,
            `  if (part < 1.0) colour = mix(evogsBand${band}(${before}, ${width}, from, direction), colour, part);`,
            `  ${g}.rgba.rgb += colour;`,
            "}",
          );
        }
        return [...lines, "}"];
      },
    });
    return node.outputs.gsplat;
  }
}

/** A texture of some texels for each splat, whose memory is 0: no copy of it is kept here. */
function newTexture({ width, rows }: Layout, texels: number, format: "RGBA32UI" | "R32UI"): THREE.DataTexture {
  const channels = format === "R32UI" ? THREE.RedIntegerFormat : THREE.RGBAIntegerFormat;
  const texture = new THREE.DataTexture(null, texels * width, rows, channels, THREE.UnsignedIntType);
  texture.internalFormat = format;
  texture.unpackAlignment = 4;
  texture.source.dataReady = false;
  texture.needsUpdate = true;
  return texture;
}
