/** `dGST`: the table of digests (spec 5.7, 12.6). */

import { viewOf } from "./bytes.js";
import type { Chunk } from "./chunks.js";
import { check } from "./faults.js";
import { HEADER_SIZE, type Header } from "./header.js";
import { CORE, N_COMPONENTS, PALETTE, channelsOf } from "./model.js";
import type { PacketTable } from "./packetTable.js";

const ROW_SIZE = 41;
/** Bytes of state that the rows may name for each byte of the file (R-5.7-5). */
const STATE_PER_BYTE = 4096n;

/** The rows, in their order. */
export interface Digests {
  /** Where `dGST` begins, for E_DIGEST. */
  offset: number;
  /** The packet of each row. */
  packet: Int32Array;
  /** 32 bytes for each row. */
  digest: Uint8Array;
}

/** The bytes of the state of a packet's component after its step (7.7, 12.6). */
export function stateSize(table: PacketTable, packet: number, shDegree: number): number {
  const component = table.component[packet];
  const n = table.slotsAfter[packet];
  if (component === CORE) return 4 + 61 * n;
  return 4 + 4 * channelsOf(component, shDegree).count * n;
}

export function parseDigests(chunk: Chunk | undefined, header: Header, table: PacketTable): Digests | null {
  if (!chunk) return null;
  const { body, offset } = chunk;
  check(body.length % ROW_SIZE === 0, "E_CHUNK", offset, "size of dGST");
  const n = body.length / ROW_SIZE;
  const view = viewOf(body);
  const digests = { offset, packet: new Int32Array(n), digest: new Uint8Array(32 * n) };
  const fileSize =
    BigInt(HEADER_SIZE + header.chunksSize) + BigInt(header.dataSizeLow) + (BigInt(header.dataSizeHigh) << 32n);
  let left = STATE_PER_BYTE * fileSize;
  // The row before: its chain, its step and its packet. Rows grow, so a chain is walked once.
  let chainBefore = -1;
  let stepBefore = -1;
  let packet = -1;
  for (let r = 0; r < n; r++) {
    const at = r * ROW_SIZE;
    const tile = view.getUint32(at, true);
    const component = body[at + 4];
    const step = view.getUint32(at + 5, true);
    // Wider than a chain number: a component that no stream has must not look like another tile.
    const chain = tile * 256 + component;
    const isAfter = chain > chainBefore || (chain === chainBefore && step > stepBefore);
    check(isAfter, "E_CHUNK", offset, "order of rows");
    if (chain !== chainBefore) {
      const exists = tile < header.nTiles && component < N_COMPONENTS && (component !== PALETTE || tile === 0);
      packet = exists ? table.first[tile * N_COMPONENTS + component] : -1;
    }
    while (packet >= 0 && table.step[packet] < step) packet = table.next[packet];
    check(packet >= 0, "E_CHUNK", offset, "a row names no packet");
    left -= BigInt(stateSize(table, packet, header.shDegree));
    check(left >= 0n, "E_AMPLIFICATION", offset);
    chainBefore = chain;
    stepBefore = step;
    digests.packet[r] = packet;
    digests.digest.set(body.subarray(at + 9, at + ROW_SIZE), 32 * r);
  }
  return digests;
}
