/** The lists of a packet (spec 5.9), with their planes in the memory of the engine. */

import { checkFrame } from "../frames.js";
import type { ListLayout, StepCounts } from "../lists.js";
import { parsePacketHead } from "../packet.js";
import { MAX_DELTA } from "../arithmetic.js";
import { hasDelta, isLowPlaneClean, isPacked, lowOf } from "../planes.js";
import { type Engine, need } from "./engine.js";

export interface Lists {
  flags: number;
  layout: ListLayout;
  coding: Uint8Array;
  /** The address of the planes of each list. */
  planes: Float64Array;
}

/** Reads a packet of size above 0. Throws a StreamError or NotCompiled at any fault. */
export function readLists(
  engine: Engine,
  bytes: Uint8Array,
  crc: number,
  component: number,
  shDegree: number,
  counts: StepCounts,
): Lists {
  const { kernels } = engine;
  const { flags, layout, coding, starts, total, frames } = parsePacketHead(bytes, component, shDegree, counts, 0);
  const planes = engine.take(total);
  const mark = engine.mark();
  const input = engine.take(bytes.length);
  engine.bytes.set(bytes, input);
  need(kernels.crc32(input, bytes.length) >>> 0 === crc);
  let at = planes;
  for (const { from, to, size } of frames) {
    const blocks = checkFrame(bytes.subarray(from, to), size, 0);
    need(kernels.decompress(input + from + blocks, input + to, at, size));
    at += size;
  }
  engine.release(mark);
  for (let list = 0; list < coding.length; list++) {
    starts[list] += planes;
    const n = layout.lengths[list];
    const low = lowOf(coding[list]);
    const isByte = low > 0 && low < 8 && !isPacked(low);
    if (isByte) need(kernels.areBelow(starts[list], n, low));
    else need(isLowPlaneClean(coding[list], n, engine.bytes, starts[list]));
  }
  return { flags, layout, coding, planes: starts };
}

/** The address of the stored integers of a list, as gaps, kinds, indices and picks are. */
export function storedOf(engine: Engine, { coding, layout, planes }: Lists, list: number): number {
  const n = layout.lengths[list];
  const out = engine.takeIntegers(n);
  if (coding[list] === 0) engine.at(out, n).fill(0);
  else engine.kernels.unpack(coding[list], n, planes[list], out);
  return out;
}

/**
 * Writes the signed integers of a list of psi, adds or entries, times `factor`, to `out`. None is further from 0 than
 * what is returned, which is at most 2^28.
 */
export function readSigned(engine: Engine, lists: Lists, list: number, factor: number, out: number): number {
  const { kernels } = engine;
  const { coding, layout, planes } = lists;
  const n = layout.lengths[list];
  if (coding[list] === 0) {
    engine.at(out, n).fill(0);
    return 0;
  }
  const furthest = factor * kernels.unpackSigned(coding[list], n, planes[list], factor, out);
  need(furthest <= MAX_DELTA);
  if (list < layout.adds || !hasDelta(coding[list])) return furthest;
  // Sums of products are products of sums.
  const sum = kernels.undelta(out, n) >>> 0;
  need(sum <= MAX_DELTA);
  return sum;
}

/** Whether all integers of a list are 0, and nothing is stored for it. */
export function isZero({ coding }: Lists, list: number): boolean {
  return coding[list] === 0;
}
