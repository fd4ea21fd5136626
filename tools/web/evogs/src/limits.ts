/** Limits by tier (spec 8.2), and limits of a decoder of the same names (spec 8.3). */

import { type FaultCode, StreamError } from "./faults.js";

export type LimitName =
  | "n_tiles"
  | "n_packets"
  | "n_levels"
  | "chunks_size"
  | "tile_steps"
  | "tile_slots"
  | "slots";

/** Limits of the caller: counts, and bytes for `chunks_size`. A name that is absent has no limit. */
export type Limits = Partial<Record<LimitName, number>>;

/** The limits of tiers 1, 2 and 3. */
export const TIER_LIMITS: Record<LimitName, readonly [number, number, number]> = {
  n_tiles: [64, 4096, 65536],
  n_packets: [16384, 262144, 4194304],
  n_levels: [64, 64, 64],
  chunks_size: [1048576, 33554432, 536870912],
  tile_steps: [1024, 4096, 65535],
  tile_slots: [1048576, 4194304, 16777216],
  slots: [2097152, 33554432, 2147483647],
};

/** Checks counts against the tier, and right behind it against the caller's limit. */
export class LimitChecker {
  constructor(
    private readonly tier: number,
    private readonly own: Limits,
  ) {}

  check(name: LimitName, count: number, offset: number): void {
    if (count > TIER_LIMITS[name][this.tier - 1]) this.fail("E_TIER", name, count, offset);
    const own = this.own[name];
    if (own !== undefined && count > own) this.fail("E_LIMIT", name, count, offset);
  }

  private fail(code: FaultCode, name: LimitName, count: number, offset: number): never {
    throw new StreamError(code, offset, `${name} is ${count}`);
  }
}
