/** The page: a worker that brings a scene, a renderer that draws it, and controls. */

import type { CameraPose, SplatRenderer } from "evogs-three";
import { Camera, planesOf } from "./camera.js";
import { Controls } from "./controls.js";
import { type Link, linkOf, upOf, upText } from "./link.js";
import type { FromWorker, Progress, SceneInfo, ToWorker } from "./messages.js";
import { Notices } from "./notices.js";
import { Panel } from "./panel.js";
import type { Vec } from "./vectors.js";
import { GRAPHICS_TEXT, linkText, nameOf, noWebGlText } from "./words.js";

const UPS: Vec[] = [
  [0, 0, 1],
  [0, -1, 0],
  [0, 1, 0],
  [0, 0, -1],
  [1, 0, 0],
  [-1, 0, 0],
];
declare global {
  interface Window {
    /** The scene that a page of `evogs export-html` holds. */
    evogsScene?: File;
    /** What is up in it, where its stream does not say so. */
    evogsUp?: string;
  }
}
/** The page tries again by itself so often, in ms, after the connection was lost. */
const RETRY_EVERY = 10_000;
const SLOWEST_FRAME = 0.2;
/** There the panel would hide the picture. */
const isSmall = matchMedia("(max-width: 640px), (max-height: 480px)");
/** Seconds in which splats move to what came. */
const MOTION = 0.25;

class Viewer {
  progress: Progress | null = null;
  info: SceneInfo | null = null;
  private readonly worker = new Worker(new URL("worker.js", import.meta.url));
  private readonly camera = new Camera();
  private readonly controls: Controls;
  private readonly panel: Panel;
  private readonly notices = new Notices(() => this.retry());
  private bounds: { middle: Vec; radius: number } | null = null;
  /** The view was chosen, by a link, a camera, a script or by hand: it is not fitted to what comes. */
  private hasView = false;
  private needsDraw = true;
  /** The worker waits to hear that its texels were drawn. */
  private hasNews = false;
  private isSceneOpen = false;
  private last = 0;
  private frames: number[] = [];
  private viewTimer: ReturnType<typeof setTimeout> | undefined;
  private retryTimer: ReturnType<typeof setTimeout> | undefined;
  private source: string | null = null;
  /** The scene is the one that the page itself holds. */
  private isHeld = false;
  /** What is up by the address, for the scene that it opens. */
  private up: Vec | null = null;

  /** The link is that of the first scene. */
  constructor(
    private readonly renderer: SplatRenderer,
    private link: Link | null,
  ) {
    this.controls = new Controls(renderer.canvas, this.camera, () => this.movedByHand());
    this.panel = new Panel({
      onWants: () => this.want(),
      onScrub: (bytes) => this.send({ kind: "scrub", bytes }),
      onFile: (file) => this.open(file),
      onUrl: (url) => this.open(url),
      onFit: () => this.fitAgain(),
      onUp: () => this.turnUp(),
      onLink: () => void this.copyLink(),
      onFly: (isFlying) => {
        this.controls.isFlying = isFlying;
      },
    });
    renderer.onDirty = () => {
      this.needsDraw = true;
    };
    renderer.onLost = () => this.send({ kind: "rewrite" });
    renderer.canvas.addEventListener("webglcontextlost", () =>
      this.notices.tell(GRAPHICS_TEXT, false, "graphics"),
    );
    renderer.canvas.addEventListener("webglcontextrestored", () => this.notices.hide("graphics"));
    this.worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => this.receive(data));
    this.worker.addEventListener("error", ({ message }) => this.notices.tell(`The worker failed: ${message}`));
    window.addEventListener("online", () => this.retry());
    window.addEventListener("hashchange", () => {
      if (this.camera.setText(linkOf(location).view)) this.movedByHand();
    });
    this.takeDrops();
    window.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resize()).observe(renderer.canvas);
    this.resize();
    requestAnimationFrame((now) => this.frame(now));
  }

  open(source: string | File): void {
    if (typeof source !== "string") {
      this.source = null;
      this.isHeld = source === window.evogsScene;
      this.start(source, source.name);
      return;
    }
    const url = URL.canParse(source, location.href) ? new URL(source, location.href) : null;
    if (url === null || !/^https?:$/.test(url.protocol)) {
      this.notices.tellBriefly("Only http and https addresses can be opened.");
      return;
    }
    this.source = url.href;
    this.isHeld = false;
    this.start(url.href, nameOf(url.href));
  }

  private start(source: string | File, name: string): void {
    clearTimeout(this.retryTimer);
    this.info = null;
    this.bounds = null;
    this.progress = null;
    this.isSceneOpen = false;
    this.camera.reset();
    this.up = this.link?.up ?? null;
    const up = this.up ?? (this.isHeld ? upOf(window.evogsUp ?? "") : null);
    if (up !== null) this.camera.up = up;
    this.hasView = this.camera.setText(this.link?.view ?? "");
    this.link = null;
    // Nothing of the scene before is shown under the name of this one.
    this.renderer.openParts();
    this.panel.clear(name);
    this.notices.open();
    if (isSmall.matches) this.panel.fold();
    const { maxTextureSize } = this.renderer;
    this.send({ kind: "open", source, wants: this.panel.wants, maxTextureSize });
  }

  setRate(bytesPerSecond: number): void {
    this.panel.setRate(bytesPerSecond);
    this.want();
  }

  setUp(up: Vec): void {
    this.camera.up = up;
    this.moved();
  }

  /** Looks from a pose until the camera is moved. */
  setPose(pose: CameraPose): void {
    this.camera.fixed = pose;
    this.hasView = true;
    this.moved();
  }

  /** Whether the picture is that of the last message of the worker and the last move. */
  get isSettled(): boolean {
    return !this.needsDraw && this.renderer.isSettled;
  }

  private send(message: ToWorker): void {
    this.worker.postMessage(message);
  }

  private want(): void {
    this.send({ kind: "want", wants: this.panel.wants });
    this.renderer.setShDegree(this.panel.wants.shDegree);
  }

  private receive(message: FromWorker): void {
    switch (message.kind) {
      case "opened":
        this.info = message.info;
        this.panel.opened(message.info);
        this.turnTo(message.info);
        if (message.layout === null) this.renderer.openParts();
        else this.renderer.open(message.layout);
        this.isSceneOpen = true;
        break;
      case "part":
        if (!this.isSceneOpen) return;
        if (message.isFresh) this.renderer.openPart(message.part, message.layout, message.at);
        this.renderer.updatePart(message.part, message.updates, message.count);
        this.renderer.setShDegree(this.panel.wants.shDegree);
        this.needsDraw = true;
        this.hasNews = true;
        break;
      case "parts":
        this.renderer.showParts(message.shown, message.kept);
        this.needsDraw = true;
        break;
      case "bounds":
        this.bounds = message;
        if (!this.hasView) {
          this.fit();
        } else {
          this.camera.radius = message.radius;
          this.moved();
        }
        break;
      case "texels":
        if (!this.isSceneOpen) return;
        if (message.isFresh) this.renderer.open(message.layout);
        this.renderer.setShDegree(this.panel.wants.shDegree);
        this.renderer.update(message.updates, message.count, message.isFresh ? 0 : MOTION);
        this.needsDraw = true;
        this.hasNews = true;
        break;
      case "progress":
        this.show(message.progress);
        break;
      case "failed":
        this.fail(message);
        break;
    }
  }

  /** Takes what a scene says of how to look at it; what a link or a script gave stays. */
  private turnTo({ up, camera }: SceneInfo): void {
    const above = this.up ?? camera?.up ?? up;
    if (above !== null) this.camera.up = above;
    if (camera === null || this.hasView) return;
    this.camera.lookFrom(camera, this.camera.up);
    this.hasView = true;
    this.moved();
  }

  private show(progress: Progress): void {
    this.progress = progress;
    this.panel.show(progress);
    this.notices.show(progress);
    if (!this.notices.hasFailed) document.body.dataset.state = stateOf(progress);
  }

  private fail(message: Extract<FromWorker, { kind: "failed" }>): void {
    this.notices.fail(message, this.info !== null);
    document.body.dataset.state = "failed";
    if (message.failure === "lost") this.retryTimer = setTimeout(() => this.retry(), RETRY_EVERY);
  }

  private retry(): void {
    clearTimeout(this.retryTimer);
    this.send({ kind: "retry" });
  }

  private fit(): void {
    if (this.bounds === null) return;
    const { clientWidth, clientHeight } = this.renderer.canvas;
    this.camera.fit(this.bounds.middle, this.bounds.radius, clientWidth / Math.max(1, clientHeight));
    this.moved();
  }

  /** Fits the scene also to what is still to come. */
  private fitAgain(): void {
    this.hasView = false;
    this.fit();
  }

  private turnUp(): void {
    const at = UPS.findIndex((up) => up.every((x, i) => x === this.camera.up[i]));
    this.camera.fixed = null;
    this.setUp(UPS[(at + 1) % UPS.length]);
  }

  private async copyLink(): Promise<void> {
    const url = new URL(location.href);
    url.hash = `view=${this.camera.text}`;
    if (this.source !== null) url.searchParams.set("src", this.source);
    url.searchParams.set("up", upText(this.camera.up));
    history.replaceState(null, "", url);
    const isLocal = this.source === null && !this.isHeld;
    this.notices.tellBriefly(linkText(await isWritten(url.href), isLocal));
  }

  private takeDrops(): void {
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file) return this.open(file);
      const url = event.dataTransfer?.getData("text/uri-list") || event.dataTransfer?.getData("text/plain");
      if (url) this.open(url.split("\n")[0].trim());
    });
  }

  private key(event: KeyboardEvent): void {
    const isTyping = event.target instanceof HTMLInputElement && event.target.type === "text";
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.toLowerCase();
    if (key === "f") this.fitAgain();
    else if (key === "u") this.turnUp();
    else if (key === "p") this.panel.togglePause();
  }

  private movedByHand(): void {
    this.hasView = true;
    this.moved();
  }

  private moved(): void {
    this.needsDraw = true;
    this.viewTimer ??= setTimeout(() => {
      this.viewTimer = undefined;
      const { pose } = this.camera;
      const { clientWidth, clientHeight } = this.renderer.canvas;
      const planes = planesOf(pose, clientWidth / Math.max(1, clientHeight));
      const pixels = Math.max(1, clientHeight) / (2 * Math.tan(pose.fovY / 2));
      this.send({ kind: "view", view: { eye: [...pose.eye], planes, pixels } });
    }, 300);
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.renderer.canvas;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer.resize(clientWidth, clientHeight, Math.min(2, devicePixelRatio));
    this.needsDraw = true;
    // More or less is seen now. Before there is a scene, there is no view of it.
    if (this.bounds !== null) this.moved();
  }

  private frame(now: number): void {
    requestAnimationFrame((next) => this.frame(next));
    const seconds = Math.min(SLOWEST_FRAME, (now - this.last) / 1000);
    this.last = now;
    if (this.controls.step(seconds)) this.movedByHand();
    this.frames = this.frames.filter((at) => at > now - 1000);
    if (this.needsDraw || this.renderer.isMoving) {
      this.needsDraw = false;
      this.renderer.draw(this.camera.pose);
      this.frames.push(now);
    }
    // The next texels come when these are on the screen, and splats are where they belong.
    if (this.hasNews && !this.renderer.isMoving) {
      this.hasNews = false;
      this.send({ kind: "drawn" });
    }
    this.panel.showFrames(this.frames.length > 1 ? this.frames.length : null);
  }
}

/** How the scene comes, for the style of the page and for scripts. */
function stateOf({ isDone, state, failedFiles = [] }: Progress): string {
  if (isDone) return "done";
  return state === "stopped" && failedFiles.length > 0 ? "failed" : state;
}

/** Copies a text. False where the browser does not let the page do so. */
async function isWritten(text: string): Promise<boolean> {
  try {
    // Only pages of https and of this machine have a clipboard.
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}

async function start(): Promise<void> {
  const { SparkSplats } = await import("./renderer.js");
  const canvas = document.getElementById("view") as HTMLCanvasElement;
  let renderer: SplatRenderer;
  try {
    renderer = new SparkSplats(canvas);
  } catch (error) {
    new Notices(() => {}).tell(noWebGlText(error));
    return;
  }
  const viewer = new Viewer(renderer, linkOf(location));
  const parameters = new URLSearchParams(location.search);
  const rate = Number(parameters.get("rate"));
  if (rate > 0) viewer.setRate(rate);
  const source = window.evogsScene ?? parameters.get("src");
  if (source) viewer.open(source);
  // For scripts and tests.
  Object.assign(window, { evogsViewer: viewer });
}

void start();
