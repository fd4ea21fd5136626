/** `ALFA`: tables of alpha (spec 5.4). */

import { viewOf } from "./bytes.js";
import type { Chunk } from "./chunks.js";
import { check } from "./faults.js";
import type { Header } from "./header.js";

const N_GROUPS = 5;
const TABLE_HEADER_SIZE = 4;

/** A table: entry a means alpha = a / 2^shift. */
export interface AlphaTable {
  shift: number;
  entries: Int16Array;
}

/** The table of a label and group that have none in the file: alpha is 1. */
const SYMMETRIC: AlphaTable = { shift: 0, entries: new Int16Array([1]) };

/** The tables by label of the packet and by group. */
export class AlphaTables {
  private readonly tables = new Map<number, AlphaTable>();

  get(level: number, group: number): AlphaTable {
    return this.tables.get(level * N_GROUPS + group) ?? SYMMETRIC;
  }

  set(level: number, group: number, table: AlphaTable): void {
    this.tables.set(level * N_GROUPS + group, table);
  }
}

export function parseAlphaTables(chunk: Chunk | undefined, header: Header): AlphaTables {
  const tables = new AlphaTables();
  if (!chunk) return tables;
  const { body, offset } = chunk;
  const view = viewOf(body);
  let before = -1;
  for (let at = 0; at < body.length; ) {
    check(at + TABLE_HEADER_SIZE <= body.length, "E_CHUNK", offset, "header of an alpha table");
    const [level, group, shift, last] = body.subarray(at, at + TABLE_HEADER_SIZE);
    check(level < header.nLevels && group < N_GROUPS && shift <= 12, "E_ALPHA", offset);
    const place = level * N_GROUPS + group;
    check(place > before, "E_ALPHA", offset, "order of alpha tables");
    before = place;
    at += TABLE_HEADER_SIZE;
    check(at + 2 * (last + 1) <= body.length, "E_CHUNK", offset, "entries of an alpha table");
    const entries = new Int16Array(last + 1);
    for (let i = 0; i <= last; i++) entries[i] = view.getInt16(at + 2 * i, true);
    tables.set(level, group, { shift, entries });
    at += 2 * (last + 1);
  }
  return tables;
}
