/** What a viewer sees of the tiles of a scene. */

import type { Directory } from "evogs";
import type { Point } from "./tileset.js";

/** Planes (a, b, c, d) with a x + b y + c z + d >= 0 inside what is seen. */
export type Planes = readonly (readonly [number, number, number, number])[];

/** What is looked at, in the coordinates of the scene. */
export interface View {
  eye: Point;
  planes: Planes;
}

/** Rays along a side of the picture. */
const GRID = 12;
/** Part of the picture; a tile that covers more is no more urgent. */
const ENOUGH = 0.25;
/** The least weight: splats reach out of their boxes, and the view may turn. */
const UNSEEN = 0.3;

/**
 * How urgent each tile is: by the part of the picture that it covers, to a quarter of it, or to the mean of the tiles
 * in sight if that is less. A box that is around the viewer, or behind all else, is not taken for small.
 */
export function tileWeights(directory: Directory, view: View): Float64Array {
  const covers = tileCovers(directory, view);
  const seen = covers.filter((cover) => cover > 0);
  const mean = seen.reduce((a, b) => a + b, 0) / Math.max(seen.length, 1);
  const enough = seen.length > 0 ? Math.min(ENOUGH, mean) : ENOUGH;
  return covers.map((cover) => Math.min(1, Math.max(UNSEEN, cover / enough)));
}

/**
 * Part of the picture that each tile covers, on a grid of rays; half a ray if none meets it, and nothing if all of it
 * is beyond a plane. Where the planes bound no picture, all or nothing.
 */
function tileCovers(directory: Directory, view: View): Float64Array {
  const { tiles, header } = directory;
  const unit = 2 ** -header.gridExponents[0];
  const rays = raysOf(view);
  return Float64Array.from({ length: header.nTiles }, (_, t) => {
    const ends = (of: ArrayLike<number>) => perAxis((a) => (tiles.origin[3 * t + a] + of[3 * t + a]) * unit);
    const low = ends(tiles.boxMin);
    const high = ends(tiles.boxMax);
    const isSeen = isInSight(low, high, view.planes);
    if (!isSeen || rays.length === 0) return isSeen ? 1 : 0;
    const met = rays.filter((way) => meets(view.eye, way, low, high)).length;
    return Math.max(met, 0.5) / rays.length;
  });
}

/** Whether no plane has all of a box behind it. */
export function isInSight(low: Point, high: Point, planes: Planes): boolean {
  return planes.every(([a, b, c, d]) => {
    // The corner that is farthest inside.
    const [x, y, z] = [a, b, c].map((slope, axis) => (slope > 0 ? high[axis] : low[axis]));
    return a * x + b * y + c * z + d >= 0;
  });
}

/** Whether a ray from a point meets a box. */
function meets(eye: Point, way: Point, low: Point, high: Point): boolean {
  let enters = 0;
  let leaves = Number.POSITIVE_INFINITY;
  for (let a = 0; a < 3; a++) {
    const [one, other] = [(low[a] - eye[a]) / way[a], (high[a] - eye[a]) / way[a]];
    enters = Math.max(enters, Math.min(one, other));
    leaves = Math.min(leaves, Math.max(one, other));
  }
  return leaves >= enters;
}

/** A grid of directions over the picture that the planes through the eye bound; none if they bound no picture. */
function raysOf({ eye, planes }: View): Point[] {
  const sides: Point[] = planes
    .filter(([a, b, c, d]) => {
      const terms = [a * eye[0], b * eye[1], c * eye[2], d];
      return Math.abs(sum(terms)) <= 1e-6 * sum(terms.map(Math.abs));
    })
    .map(([a, b, c]) => unitOf([a, b, c]));
  const isInside = (way: Point) => sides.every((side) => dot(side, way) >= -1e-9);
  const corners = sides
    .flatMap((side, i) => sides.slice(i + 1).map((other) => cross(side, other)))
    .filter((way) => Math.hypot(...way) > 1e-9)
    .map(unitOf)
    .flatMap((way) => [way, scaled(way, -1)])
    .filter(isInside);
  if (corners.length < 3) return [];
  const middle = unitOf(perAxis((a) => sum(corners.map((way) => way[a]))));
  const across = unitOf(plus(sides[0], middle, -dot(sides[0], middle)));
  const along = cross(middle, across);
  const axes = [across, along].map((axis) => {
    const at = corners.map((way) => dot(way, axis) / dot(way, middle));
    const [from, to] = [Math.min(...at), Math.max(...at)];
    return Array.from({ length: GRID }, (_, k) => from + ((k + 0.5) / GRID) * (to - from));
  });
  return axes[0].flatMap((x) => axes[1].map((y) => plus(plus(middle, across, x), along, y))).filter(isInside);
}

const perAxis = (of: (axis: number) => number): Point => [of(0), of(1), of(2)];
const sum = (numbers: readonly number[]) => numbers.reduce((a, b) => a + b, 0);
const dot = (a: Point, b: Point) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const scaled = ([x, y, z]: Point, by: number): Point => [x * by, y * by, z * by];
const plus = (a: Point, b: Point, by: number): Point => [a[0] + b[0] * by, a[1] + b[1] * by, a[2] + b[2] * by];
const unitOf = (a: Point) => scaled(a, 1 / Math.hypot(...a));
const cross = (a: Point, b: Point): Point => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
