/** Which packets are wanted, and in which order. */

import { CORE, type Directory, HEADER_SIZE, PALETTE, PICKS } from "evogs";

/** The packets that are wanted, the most urgent first. Packets that are not named are not fetched. */
export type Order = (directory: Directory) => ArrayLike<number>;

/** What bounds a selection of packets. What is absent has no bound. */
export interface Budget {
  /** Live splats. */
  splats?: number;
  /** Bytes, with the directory. */
  bytes?: number;
  /** SH bands above this are left out. With a palette, all of them or none. */
  shDegree?: number;
  /** Levels above this are left out. */
  level?: number;
}

/** What is looked at, in the coordinates of the scene. */
export interface View {
  eye: readonly [number, number, number];
  /** Planes (a, b, c, d) with a x + b y + c z + d >= 0 inside what is seen. */
  planes: readonly (readonly [number, number, number, number])[];
}

/** The order of the file, in which its encoder put what gains most first. */
export function fileOrder(budget: Budget = {}): Order {
  return (directory) =>
    withinBudget(
      directory,
      Array.from({ length: directory.packets.length }, (_, i) => i),
      budget,
    );
}

/**
 * The order of the file, which is that of gain per byte, with tiles ahead that look large: a packet comes as early as
 * if the file had it at its place over the weight of its tile.
 */
export function viewOrder(view: View, budget: Budget = {}): Order {
  return (directory) => {
    const { packets } = directory;
    const weights = tileWeights(directory, view);
    const heaviest = weights.reduce((a, b) => Math.max(a, b), 0);
    const value = new Float64Array(packets.length);
    const before = new Int32Array(packets.first.length).fill(-1);
    let paletteBefore = Number.POSITIVE_INFINITY;
    for (let i = 0; i < packets.length; i++) {
      const component = packets.component[i];
      const chain = packets.chainOf(i);
      let v = component === PALETTE ? heaviest : weights[packets.tile[i]];
      v /= packets.offset[i];
      // Nothing comes before what it needs: the packet before it, its core, and the palette.
      if (before[chain] >= 0) v = Math.min(v, value[before[chain]]);
      if (component !== CORE && component !== PALETTE) v = Math.min(v, value[packets.core[i]]);
      if (component === PICKS) v = Math.min(v, paletteBefore);
      if (component === PALETTE) paletteBefore = Math.min(paletteBefore, v);
      value[i] = v;
      before[chain] = i;
    }
    const order = Array.from({ length: packets.length }, (_, i) => i).sort((a, b) => value[b] - value[a] || a - b);
    return withinBudget(directory, order, budget);
  };
}

/** Points of a box along an axis, which tell how much of it is in sight, and how near. */
const POINTS = 5;
/** The least weight: splats reach out of their boxes, and the view may turn. */
const UNSEEN = 0.3;

/** How large each tile looks: the root of the area of its part in sight, to that of the largest one. */
function tileWeights(directory: Directory, { eye, planes }: View): Float64Array {
  const { tiles, header } = directory;
  const unit = 2 ** -header.gridExponents[0];
  const weights = Float64Array.from({ length: header.nTiles }, (_, t) => {
    const at = (axis: number, k: number) => {
      const i = 3 * t + axis;
      return (
        (tiles.origin[i] + tiles.boxMin[i] + ((k + 0.5) / POINTS) * (tiles.boxMax[i] - tiles.boxMin[i])) * unit
      );
    };
    let sum = 0;
    for (let k = 0; k < POINTS ** 3; k++) {
      const x = at(0, k % POINTS);
      const y = at(1, Math.floor(k / POINTS) % POINTS);
      const z = at(2, Math.floor(k / POINTS ** 2));
      if (!planes.every(([a, b, c, d]) => a * x + b * y + c * z + d >= 0)) continue;
      sum += 1 / Math.max((x - eye[0]) ** 2 + (y - eye[1]) ** 2 + (z - eye[2]) ** 2, unit ** 2);
    }
    return sum;
  });
  const largest = weights.reduce((a, b) => Math.max(a, b), Number.MIN_VALUE);
  return weights.map((weight) => Math.max(UNSEEN, Math.sqrt(weight / largest)));
}

/** Takes packets in order while they fit. What needs a packet that does not fit is left out too. */
function withinBudget(directory: Directory, order: ArrayLike<number>, budget: Budget): Int32Array {
  const { packets, header } = directory;
  const { splats = Number.POSITIVE_INFINITY, bytes = Number.POSITIVE_INFINITY } = budget;
  const { shDegree = 3, level = header.nLevels - 1 } = budget;
  const taken: number[] = [];
  const isOut = new Uint8Array(packets.length);
  let nSplats = 0;
  let nBytes = HEADER_SIZE + header.chunksSize;
  const isPaletteOut = () => shDegree === 0;
  const cutChains = new Uint8Array(packets.first.length);
  for (let k = 0; k < order.length; k++) {
    const i = order[k];
    const component = packets.component[i];
    const chain = packets.chainOf(i);
    const made = component === CORE ? packets.nAdds[i] + packets.nSplits[i] - packets.nDrops[i] : 0;
    const isBand = component > CORE && component < PICKS;
    const isLeftOut =
      cutChains[chain] === 1 ||
      packets.label[i] > level ||
      (isBand && component > shDegree) ||
      (component >= PICKS && isPaletteOut()) ||
      (component !== CORE && component !== PALETTE && isOut[packets.core[i]] === 1) ||
      nSplats + made > splats ||
      nBytes + packets.size[i] > bytes;
    if (isLeftOut) {
      isOut[i] = 1;
      cutChains[chain] = 1;
      continue;
    }
    nSplats += made;
    nBytes += packets.size[i];
    taken.push(i);
  }
  return Int32Array.from(taken);
}
