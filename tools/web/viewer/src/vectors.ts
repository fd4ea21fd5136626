/** Vectors of three numbers. */

export type Vec = readonly [number, number, number];

export const add = (a: Vec, b: Vec, scale = 1): Vec => [
  a[0] + scale * b[0],
  a[1] + scale * b[1],
  a[2] + scale * b[2],
];
export const dot = (a: Vec, b: Vec): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: Vec, b: Vec): Vec => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const scaled = (a: Vec, scale: number): Vec => [scale * a[0], scale * a[1], scale * a[2]];
export const unit = (a: Vec): Vec => scaled(a, 1 / (Math.hypot(...a) || 1));
