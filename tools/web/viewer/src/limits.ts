/** What the page takes of files from unknown sources. */

import type { Limits } from "evogs";

/** At most about 2 GB of memory. */
export const LIMITS = {
  slots: 8_000_000,
  chunks_size: 64 * 1024 * 1024,
  n_packets: 1_000_000,
} as const satisfies Limits;
