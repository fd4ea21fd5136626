/** Digests are checked (R-5.7-3, R-5.7-4). */

import type { Digests } from "./digests.js";
import { StreamError } from "./faults.js";
import type { Scene } from "./scene.js";
import { digestOf } from "./state.js";

export class Verifier {
  /** Digests that were compared, and those of them that differ. */
  checked = 0;
  wrong = 0;
  private readonly rows = new Map<number, number>();
  private firstWrong = Number.POSITIVE_INFINITY;

  constructor(private readonly digests: Digests) {
    digests.packet.forEach((packet, row) => this.rows.set(packet, row));
  }

  /** Takes the digest of packet `i`, which was just applied, and compares it if a row names it. */
  check(scene: Scene, i: number): void {
    const row = this.rows.get(i);
    if (row === undefined) return;
    const { packets } = scene.directory;
    const digest = digestOf(scene, packets.tile[i], packets.component[i]);
    const isRight = digest.every((byte, k) => byte === this.digests.digest[32 * row + k]);
    this.checked++;
    if (isRight) return;
    this.wrong++;
    this.firstWrong = Math.min(this.firstWrong, row);
  }

  /** E_DIGEST, if a digest differs. It is reported after all other faults. */
  fault(): StreamError | null {
    if (this.firstWrong === Number.POSITIVE_INFINITY) return null;
    return new StreamError("E_DIGEST", this.digests.offset, `row ${this.firstWrong}`);
  }
}
