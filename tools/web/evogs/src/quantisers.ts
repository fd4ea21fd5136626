/** `QUAN`: quantisers (spec 5.3). */

import { viewOf } from "./bytes.js";
import type { Chunk } from "./chunks.js";
import { check } from "./faults.js";
import type { Header } from "./header.js";

const ENTRY_SIZE = 3;

/** The quantiser of row r and class c is mantissa and shift at r * nClasses + c. */
export interface Quantisers {
  nClasses: number;
  mantissa: Uint16Array;
  shift: Uint8Array;
}

/** The row of adds and of entries of all levels. The row of psi of level i is 1 + i. */
export const ROW_OF_ADDS = 0;

export function parseQuantisers(chunk: Chunk, header: Header): Quantisers {
  const { body, offset } = chunk;
  const nClasses = 5 + header.shDegree;
  const n = (1 + header.nLevels) * nClasses;
  check(body.length === n * ENTRY_SIZE, "E_CHUNK", offset, "size of QUAN");
  const view = viewOf(body);
  const mantissa = new Uint16Array(n);
  const shift = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    mantissa[i] = view.getUint16(ENTRY_SIZE * i, true);
    shift[i] = body[ENTRY_SIZE * i + 2];
    check(mantissa[i] >= 1, "E_STEP", offset, "M is 0");
    check(shift[i] <= 24, "E_STEP", offset, "E is above 24");
  }
  return { nClasses, mantissa, shift };
}
