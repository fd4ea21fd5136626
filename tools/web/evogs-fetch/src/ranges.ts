/** Packets to ranges that are asked for. */

import type { PacketTable } from "evogs";
import type { ByteRange, Intervals } from "./intervals.js";

/** Bytes that nobody wants, and bytes that are wanted later, between two packets of a request. */
const MAX_UNWANTED = 4096;
const MAX_LATER = 65536;

/**
 * The ranges to ask for next: those of the first wanted packets that are not `claimed`, about `size` bytes,
 * joined where they are near. The range of the most urgent packet comes first.
 */
export function nextRanges(
  packets: PacketTable,
  order: ArrayLike<number>,
  claimed: Intervals,
  size: number,
): ByteRange[] {
  const wanted: ByteRange[] = [];
  let urgent = -1;
  let nBytes = 0;
  let k = 0;
  for (; k < order.length && nBytes < size; k++) {
    const start = packets.offset[order[k]];
    for (const part of claimed.missing(start, start + packets.size[order[k]])) {
      // A large packet is fetched in pieces.
      const end = Math.min(part.end, Math.ceil(part.start + size - nBytes));
      if (end <= part.start) break;
      if (urgent < 0) urgent = part.start;
      nBytes += end - part.start;
      wanted.push({ start: part.start, end });
    }
  }
  if (wanted.length === 0) return [];
  const isLater = new Uint8Array(packets.length);
  for (; k < order.length; k++) isLater[order[k]] = 1;
  wanted.sort((a, b) => a.start - b.start);
  const ranges: ByteRange[] = [];
  for (const part of wanted) {
    const open = ranges[ranges.length - 1];
    if (open && isBridged(packets, isLater, claimed, open.end, part.start)) open.end = part.end;
    else ranges.push({ ...part });
  }
  const first = ranges.findIndex(({ start, end }) => start <= urgent && urgent < end);
  return [...ranges.splice(first, 1), ...ranges];
}

/** Whether the bytes between two parts of a request may come with them: never bytes that came. */
function isBridged(
  packets: PacketTable,
  isLater: Uint8Array,
  claimed: Intervals,
  start: number,
  end: number,
): boolean {
  if (start >= end) return true;
  if (end - start > MAX_LATER) return false;
  const gap = claimed.missing(start, end);
  if (gap.length !== 1 || gap[0].start !== start || gap[0].end !== end) return false;
  let unwanted = 0;
  for (let i = packets.at(start); i < packets.length && packets.offset[i] < end; i++) {
    const overlap = Math.min(end, packets.offset[i] + packets.size[i]) - Math.max(start, packets.offset[i]);
    if (isLater[i] === 0 && overlap > 0) unwanted += overlap;
  }
  return unwanted <= MAX_UNWANTED;
}
