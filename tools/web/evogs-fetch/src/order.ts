/** Which packets are wanted, and in which order. */

import { CORE, type Directory, HEADER_SIZE, PALETTE, PICKS } from "evogs";
import { type View, tileWeights } from "./sight.js";

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
 * The order of the file, which is that of gain per byte, with tiles ahead that cover much of the
 * picture: a packet comes as early as if the file had it at its place over the weight of its tile.
 */
export function viewOrder(view: View, budget: Budget = {}): Order {
  return (directory) => {
    const { packets } = directory;
    const weights = tileWeights(directory, view);
    const heaviest = weights.reduce((a, b) => Math.max(a, b), 0);
    const value = new Float64Array(packets.length);
    const before = new Int32Array(packets.first.length).fill(-1);
    for (let i = 0; i < packets.length; i++) {
      const component = packets.component[i];
      const chain = packets.chainOf(i);
      let v = component === PALETTE ? heaviest : weights[packets.tile[i]];
      v /= packets.offset[i];
      // Nothing comes before what it needs: the packet before it, its core, and entries of the palette.
      if (before[chain] >= 0) v = Math.min(v, value[before[chain]]);
      if (component !== CORE && component !== PALETTE) v = Math.min(v, value[packets.core[i]]);
      if (packets.palette[i] >= 0) v = Math.min(v, value[packets.palette[i]]);
      value[i] = v;
      before[chain] = i;
    }
    const order = Array.from({ length: packets.length }, (_, i) => i).sort((a, b) => value[b] - value[a] || a - b);
    return withinBudget(directory, order, budget);
  };
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
      (packets.palette[i] >= 0 && isOut[packets.palette[i]] === 1) ||
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
