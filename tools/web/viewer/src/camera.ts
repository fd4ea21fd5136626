/** The camera: it orbits a point, or flies. */

import type { CameraPose } from "evogs-three";
import type { Viewpoint } from "evogs";
import { type Vec, add, cross, dot, scaled, unit } from "./vectors.js";

const FOV_Y = (50 * Math.PI) / 180;
const YAW = 0.6;
const PITCH = -0.25;
const UP: Vec = [0, 0, 1];
const STEEPEST = Math.PI / 2 - 0.01;

export class Camera {
  /** What it orbits. */
  target: Vec = [0, 0, 0];
  distance = 5;
  /** Angles of what it looks along, from the horizon of `up`. */
  yaw = YAW;
  pitch = PITCH;
  up = UP;
  fovY = FOV_Y;
  /** How large the scene is: speeds and clipping follow it. */
  radius = 1;
  /** A pose that was set from outside, until the camera moves. */
  fixed: CameraPose | null = null;

  /** Looks at a scene as a whole. */
  fit(middle: Vec, radius: number, aspect: number): void {
    this.fixed = null;
    this.target = middle;
    this.radius = radius;
    const half = Math.atan(Math.tan(this.fovY / 2) * Math.min(1, aspect));
    this.distance = (1.15 * radius) / Math.sin(half);
  }

  /** Looks as the default camera of a scene does; `up` is up in the picture. */
  lookFrom({ position, target, fovY }: Viewpoint, up: Vec): void {
    const ahead = add(target, position, -1);
    this.fixed = null;
    this.up = up;
    this.target = target;
    this.distance = Math.hypot(...ahead);
    this.radius = this.distance / 3;
    this.fovY = (fovY * Math.PI) / 180;
    const [east, north, pole] = this.horizon;
    this.yaw = Math.atan2(dot(ahead, north), dot(ahead, east));
    const pitch = Math.asin(Math.max(-1, Math.min(1, dot(unit(ahead), pole))));
    this.pitch = Math.min(STEEPEST, Math.max(-STEEPEST, pitch));
  }

  /** Forgets how the scene before was looked at. */
  reset(): void {
    Object.assign(this, { yaw: YAW, pitch: PITCH, up: UP, fovY: FOV_Y, fixed: null });
  }

  get pose(): CameraPose {
    if (this.fixed !== null) return this.fixed;
    const [right, up, back] = this.rotation;
    return {
      eye: add(this.target, back, this.distance) as [number, number, number],
      rotation: [right, up, back],
      fovY: this.fovY,
      near: Math.max(0.005 * this.radius, 0.002 * this.distance),
      far: 100 * this.radius + 10 * this.distance,
    };
  }

  /** Turns around the target. */
  orbit(yaw: number, pitch: number): void {
    this.fixed = null;
    this.yaw += yaw;
    this.pitch = Math.min(STEEPEST, Math.max(-STEEPEST, this.pitch + pitch));
  }

  /** Turns around the eye. */
  look(yaw: number, pitch: number): void {
    const { eye } = this.pose;
    this.orbit(yaw, pitch);
    this.target = add(eye, this.rotation[2], -this.distance);
  }

  /** Moves to the right, up and forward, in units of the distance. */
  move(right: number, up: number, forward: number): void {
    this.fixed = null;
    const [x, y, z] = this.rotation;
    const step = add(add(scaled(x, right), y, up), z, -forward);
    this.target = add(this.target, step, this.distance);
  }

  zoom(factor: number): void {
    this.fixed = null;
    this.distance = Math.min(1e3 * this.radius, Math.max(1e-3 * this.radius, this.distance * factor));
  }

  /** A view as text, for a link: target, distance, yaw, pitch and the angle of view in degrees. */
  get text(): string {
    const numbers = [...this.target, this.distance, this.yaw, this.pitch, (this.fovY * 180) / Math.PI];
    return numbers.map((n) => Number(n.toPrecision(6))).join(",");
  }

  /** Takes a view from a link, which may lack the angle of view. False if it is none. */
  setText(text: string): boolean {
    const numbers = text.split(",").map(Number);
    if (numbers.length < 6 || numbers.length > 7 || !numbers.every(Number.isFinite)) return false;
    const [x, y, z, distance, yaw, pitch, degrees = (FOV_Y * 180) / Math.PI] = numbers;
    if (distance <= 0 || degrees <= 0 || degrees >= 180) return false;
    const fovY = (degrees * Math.PI) / 180;
    Object.assign(this, { target: [x, y, z], distance, yaw, pitch, fovY, radius: distance / 3, fixed: null });
    return true;
  }

  /** Two directions of the horizon, and up. */
  private get horizon(): [Vec, Vec, Vec] {
    const up = unit(this.up);
    const side: Vec = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    const east = unit(cross(side, up));
    return [east, cross(up, east), up];
  }

  /** Right, up and backward. */
  private get rotation(): [Vec, Vec, Vec] {
    const [east, north, up] = this.horizon;
    const level = add(scaled(east, Math.cos(this.yaw)), north, Math.sin(this.yaw));
    const ahead = add(scaled(level, Math.cos(this.pitch)), up, Math.sin(this.pitch));
    const right = unit(cross(ahead, up));
    return [right, cross(right, ahead), scaled(ahead, -1)];
  }
}

/** The planes of what a pose sees, inside positive. */
export function planesOf({ eye, rotation, fovY }: CameraPose, aspect: number): [number, number, number, number][] {
  const [right, up, back] = rotation;
  const y = Math.tan(fovY / 2);
  const x = y * aspect;
  const plane = (side: Vec, slope: number): [number, number, number, number] => {
    const [a, b, c] = add(side, back, -slope);
    return [a, b, c, -(a * eye[0] + b * eye[1] + c * eye[2])];
  };
  return [plane(right, x), plane(scaled(right, -1), x), plane(up, y), plane(scaled(up, -1), y)];
}
