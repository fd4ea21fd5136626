/** The syntax of a packet (spec 5.9): header, coding bytes, frame entries, and the planes of the frames. */

import { viewOf } from "./bytes.js";
import { check } from "./faults.js";
import { decompressFrame } from "./frames.js";
import { type ListLayout, PICKS_OF_CHANGED, type StepCounts, layoutOf, listCount } from "./lists.js";
import { PICKS } from "./model.js";
import {
  hasDelta,
  highOf,
  isLowPlaneClean,
  isPlaneOfBytes,
  lowOf,
  lowPlaneSize,
  undelta,
  unpack,
  unpackSigned,
} from "./planes.js";
import type { Workspace } from "./workspace.js";

const HEADER_SIZE = 2;
const ENTRY_SIZE = 5;

/** The lists of a packet, in planes. The planes are those of a workspace: they last until the next packet. */
export class PacketLists {
  constructor(
    readonly flags: number,
    readonly layout: ListLayout,
    private readonly coding: Uint8Array,
    private readonly planes: Uint8Array,
    /** Where the planes of each list begin. */
    private readonly starts: Float64Array,
  ) {}

  length(list: number): number {
    return this.layout.lengths[list];
  }

  /** Whether all integers of a list are 0, and nothing is stored for it. */
  isZero(list: number): boolean {
    return this.coding[list] === 0;
  }

  /** The stored integers of a list, as gaps, kinds, indices and picks are. */
  read(list: number, out: Int32Array): void {
    const n = this.layout.lengths[list];
    if (this.coding[list] === 0) out.fill(0, 0, n);
    else unpack(this.coding[list], n, this.planes, this.starts[list], out);
  }

  /** Whether a list has `delta`: running sums in adds and entries, sibling differences in psi. */
  hasDelta(list: number): boolean {
    return hasDelta(this.coding[list]);
  }

  /** The plane of a list whose integers have a byte each, or null. */
  planeOfBytes(list: number): Uint8Array | null {
    const start = this.starts[list];
    return isPlaneOfBytes(this.coding[list])
      ? this.planes.subarray(start, start + this.layout.lengths[list])
      : null;
  }

  /** No signed integer of a list without `delta` is further from 0. */
  furthest(list: number): number {
    return 2 ** (lowOf(this.coding[list]) + 8 * highOf(this.coding[list])) / 2;
  }

  /**
   * The signed integers of a list of psi, adds or entries, times `factor`, which is 1 for running sums.
   * False if a running sum is out of range.
   */
  readSigned(list: number, out: Int32Array, factor = 1): boolean {
    const n = this.layout.lengths[list];
    if (this.coding[list] === 0) {
      out.fill(0, 0, n);
      return true;
    }
    unpackSigned(this.coding[list], n, this.planes, this.starts[list], factor, out);
    return list < this.layout.adds || !this.hasDelta(list) || undelta(out, n);
  }
}

/** What stands before the frames of a packet. */
export interface PacketHead {
  flags: number;
  layout: ListLayout;
  coding: Uint8Array;
  /** Where the planes of each list begin, and bytes of all planes. */
  starts: Float64Array;
  total: number;
  /** Where each frame begins and ends in the packet, and the bytes of its planes, which follow each other. */
  frames: { from: number; to: number; size: number }[];
}

/** Reads a packet of size above 0 to R-5.9-8, in the order of 6.1. Throws a StreamError at `offset`. */
export function parsePacketHead(
  bytes: Uint8Array,
  component: number,
  shDegree: number,
  counts: StepCounts,
  offset: number,
): PacketHead {
  const nLists = listCount(component, shDegree);
  const entriesAt = HEADER_SIZE + nLists;
  check(bytes.length >= entriesAt, "E_PACKET", offset, "coding bytes are cut short");
  const flags = bytes[0];
  const nFrames = bytes[1];
  const coding = bytes.subarray(HEADER_SIZE, entriesAt);
  const layout = layoutOf(component, shDegree, flags, counts);
  checkReserved(flags, coding, component, offset);
  checkCoding(coding, layout, offset);

  const framesAt = entriesAt + ENTRY_SIZE * nFrames;
  check(bytes.length >= framesAt, "E_PACKET", offset, "frame entries are cut short");
  const { starts, sizes, total } = placePlanes(coding, layout);
  checkEntries(bytes, entriesAt, nFrames, sizes.length, offset);

  const view = viewOf(bytes);
  const frames: PacketHead["frames"] = [];
  let plane = 0;
  let from = framesAt;
  for (let entry = entriesAt; entry < framesAt; entry += ENTRY_SIZE) {
    const to = from + view.getUint32(entry + 1, true);
    let size = 0;
    for (let k = 0; k < bytes[entry]; k++) size += sizes[plane++];
    frames.push({ from, to, size });
    from = to;
  }
  return { flags, layout, coding, starts, total, frames };
}

/** Reads a packet of size above 0 to R-5.9-9, in the order of 6.1. Throws a StreamError at `offset`. */
export function parsePacket(
  bytes: Uint8Array,
  component: number,
  shDegree: number,
  counts: StepCounts,
  offset: number,
  workspace: Workspace,
): PacketLists {
  const { flags, layout, coding, starts, total, frames } = parsePacketHead(
    bytes,
    component,
    shDegree,
    counts,
    offset,
  );
  const planes = workspace.planes(total);
  let at = 0;
  for (const { from, to, size } of frames) {
    decompressFrame(bytes.subarray(from, to), size, planes, at, offset);
    at += size;
  }
  for (let list = 0; list < coding.length; list++) {
    const isClean = isLowPlaneClean(coding[list], layout.lengths[list], planes, starts[list]);
    check(isClean, "E_PACKET", offset, "a bit of a low plane that belongs to no integer");
  }
  return new PacketLists(flags, layout, coding, planes, starts);
}

function checkReserved(flags: number, coding: Uint8Array, component: number, offset: number): void {
  const reserved = component === PICKS ? 0xf8 : 0xf8 | PICKS_OF_CHANGED;
  check((flags & reserved) === 0, "E_RESERVED", offset, "flags of a packet");
  for (const c of coding) check(c < 0x80, "E_RESERVED", offset, "coding byte");
}

/** R-5.9-2, R-5.9-3 and R-5.9-4. They have one code, so their order cannot be seen. */
function checkCoding(coding: Uint8Array, layout: ListLayout, offset: number): void {
  for (let list = 0; list < coding.length; list++) {
    const c = coding[list];
    check(lowOf(c) <= 8 && highOf(c) <= 2 && c !== 0x40, "E_PACKET", offset, "coding byte");
    check(!hasDelta(c) || list >= layout.firstDelta, "E_PACKET", offset, "delta is not for this list");
    check(c === 0 || layout.lengths[list] > 0, "E_PACKET", offset, "coding byte of a list without integers");
  }
}

/** Where the planes of each list begin, the size of each plane, and of all. */
function placePlanes(
  coding: Uint8Array,
  layout: ListLayout,
): { starts: Float64Array; sizes: number[]; total: number } {
  const starts = new Float64Array(coding.length);
  const sizes: number[] = [];
  let total = 0;
  for (let list = 0; list < coding.length; list++) {
    const c = coding[list];
    const n = layout.lengths[list];
    const first = sizes.length;
    if (lowOf(c) > 0) sizes.push(lowPlaneSize(c, n));
    for (let k = 0; k < highOf(c); k++) sizes.push(n);
    starts[list] = total;
    for (let k = first; k < sizes.length; k++) total += sizes[k];
  }
  return { starts, sizes, total };
}

/** R-5.9-7 and R-5.9-8. */
function checkEntries(bytes: Uint8Array, at: number, nFrames: number, nPlanes: number, offset: number): void {
  const view = viewOf(bytes);
  let planes = 0;
  let size = at + ENTRY_SIZE * nFrames;
  for (let f = 0; f < nFrames; f++) {
    const entry = at + ENTRY_SIZE * f;
    check(bytes[entry] > 0, "E_PACKET", offset, "a frame without planes");
    planes += bytes[entry];
    size += view.getUint32(entry + 1, true);
  }
  check(planes === nPlanes, "E_PACKET", offset, "number of planes");
  check(size === bytes.length, "E_PACKET", offset, "sizes of frames");
}
