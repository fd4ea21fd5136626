/** Mouse, touch and keys move the camera. */

import type { Camera } from "./camera.js";

/** Radians for each pixel of a drag, and shares of the distance. */
const TURN = 0.005;
const SLIDE = 0.0015;
/** Shares of the distance, and radians, for each second that a key is held. */
const FLY = 0.6;
const SPIN = 1.2;

const KEYS: Record<string, [number, number, number, number, number]> = {
  // right, up, forward, yaw, pitch
  KeyW: [0, 0, 1, 0, 0],
  KeyS: [0, 0, -1, 0, 0],
  KeyA: [-1, 0, 0, 0, 0],
  KeyD: [1, 0, 0, 0, 0],
  KeyE: [0, 1, 0, 0, 0],
  KeyQ: [0, -1, 0, 0, 0],
  ArrowLeft: [0, 0, 0, 1, 0],
  ArrowRight: [0, 0, 0, -1, 0],
  ArrowUp: [0, 0, 0, 0, 1],
  ArrowDown: [0, 0, 0, 0, -1],
};

export class Controls {
  /** Drags and arrows look around from where the camera is, instead of turning it around the target. */
  isFlying = false;
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private readonly held = new Set<string>();
  /** Keys that were let go since the last step: they may have been pressed since, too. */
  private readonly released = new Set<string>();

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly camera: Camera,
    private readonly onMove: () => void,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(name, ({ pointerId }) => this.pointers.delete(pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    window.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("keyup", ({ code }) => {
      if (this.held.delete(code)) this.released.add(code);
    });
    for (const target of [canvas, window]) target.addEventListener("blur", () => this.held.clear());
  }

  /** Moves by the keys that are held. Whether there are any. */
  step(seconds: number): boolean {
    const codes = new Set([...this.held, ...this.released]);
    this.released.clear();
    for (const code of codes) {
      const [right, up, forward, yaw, pitch] = KEYS[code];
      const way = FLY * seconds;
      this.camera.move(way * right, way * up, way * forward);
      this.turn(SPIN * seconds * yaw, SPIN * seconds * pitch);
    }
    return codes.size > 0;
  }

  private down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.focus();
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  private drag(event: PointerEvent): void {
    const last = this.pointers.get(event.pointerId);
    if (last === undefined) return;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other !== undefined) {
      const before = Math.hypot(last.x - other.x, last.y - other.y);
      const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (before > 0 && after > 0) this.approach(before / after);
      // Each of the two fingers moves half of it.
      this.camera.move((-SLIDE * dx) / 2, (SLIDE * dy) / 2, 0);
    } else if (event.buttons & 6 || event.shiftKey) {
      this.camera.move(-SLIDE * dx, SLIDE * dy, 0);
    } else {
      this.turn(-TURN * dx, -TURN * dy);
    }
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.onMove();
  }

  private turn(yaw: number, pitch: number): void {
    if (yaw === 0 && pitch === 0) return;
    if (this.isFlying) this.camera.look(yaw, pitch);
    else this.camera.orbit(yaw, pitch);
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    this.approach(Math.exp(0.001 * lines * event.deltaY));
    this.onMove();
  }

  /** Changes the distance by a factor: of the eye to its target or, flying, of both to where they were. */
  private approach(factor: number): void {
    if (this.isFlying) this.camera.move(0, 0, -Math.log(factor));
    else this.camera.zoom(factor);
  }

  /** Keys count at the picture, and where nothing has the focus, as when the page has just opened. */
  private key(event: KeyboardEvent): void {
    if (event.target !== this.canvas && event.target !== document.body) return;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.code in KEYS) this.held.add(event.code);
    else if (event.key === "+" || event.key === "=") this.approach(0.9);
    else if (event.key === "-") this.approach(1 / 0.9);
    else return;
    event.preventDefault();
    this.onMove();
  }
}
