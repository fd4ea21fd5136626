/** Where most of a scene is, so that the first view shows it. */

import { type Scene, slotFloats } from "evogs";

const SAMPLES = 20000;
/** Splats whose arrival shows where the scene is. */
const ENOUGH = 32;

export interface Bounds {
  middle: [number, number, number];
  radius: number;
}

/**
 * Says where a scene is while it comes: once there are enough splats, when there are twice as many, and when no more
 * come. The first splats may be those of a sky.
 */
export class BoundsWatch {
  private count = 0;
  private wasAtRest = false;

  /** New bounds, if there is a reason for them. */
  next(scene: Scene, isAtRest: boolean): Bounds | null {
    const count = scene.splatCount();
    const isDue = isAtRest ? !this.wasAtRest : count >= Math.max(ENOUGH, 2 * this.count);
    this.wasAtRest = isAtRest;
    if (!isDue) return null;
    this.count = count;
    return boundsOf(scene);
  }
}

/**
 * The middle of the splats and a distance from it that holds most of them. A few splats far away, such as a sky,
 * do not count. Null without splats.
 */
export function boundsOf(scene: Scene): Bounds | null {
  const { nTiles } = scene.directory.header;
  const total = scene.splatCount();
  if (total === 0) return null;
  const stride = Math.max(1, Math.floor(total / SAMPLES));
  const axes: number[][] = [[], [], []];
  for (let t = 0; t < nTiles; t++) {
    const live = scene.tile(t).liveSlots();
    const numbers = [0, 1, 2].map((axis) => slotFloats(scene, t, axis));
    for (let u = 0; u < live.length; u += stride) {
      if (live[u] === 1) for (let axis = 0; axis < 3; axis++) axes[axis].push(numbers[axis][u]);
    }
  }
  const middle = axes.map((numbers) => quantile(numbers, 0.5)) as [number, number, number];
  const distances = axes[0].map((_, i) => Math.hypot(...axes.map((numbers, axis) => numbers[i] - middle[axis])));
  return { middle, radius: Math.max(quantile(distances, 0.8), 1e-6) };
}

function quantile(numbers: readonly number[], q: number): number {
  const sorted = Float64Array.from(numbers).sort();
  return sorted[Math.floor(q * (sorted.length - 1))];
}
