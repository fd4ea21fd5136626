/** How fast bytes come, and how fast they may. */

const SMALLEST = 64 * 1024;
const LARGEST = 4 * 1024 * 1024;
/** A request holds what comes in this time. */
const SECONDS_PER_REQUEST = 1;

/** Waits, unless `signal` aborts first, which rejects. */
export function sleep(ms: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    if (signal?.aborted) return reject(signal.reason);
    const stop = () => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, ms);
    signal?.addEventListener("abort", stop, { once: true });
  });
}

/** Measures the connection, from answers that took long enough to say something. */
export class Pace {
  /** Bytes for each second, and seconds to the first byte of an answer. 0 if they are not known. */
  rate = 0;
  latency = 0;

  answered(seconds: number): void {
    this.latency = this.latency === 0 ? seconds : 0.7 * this.latency + 0.3 * seconds;
  }

  received(bytes: number, seconds: number): void {
    if (bytes < 16384 || seconds <= 0) return;
    const rate = bytes / seconds;
    this.rate = this.rate === 0 ? rate : 0.5 * this.rate + 0.5 * rate;
  }

  /** Bytes of the next request. */
  requestSize(): number {
    const size = this.rate === 0 ? 2 * SMALLEST : SECONDS_PER_REQUEST * this.rate;
    return Math.round(Math.min(LARGEST, Math.max(SMALLEST, size)));
  }

  /** Bytes that come in about two round trips: so early the next request is sent. */
  ahead(): number {
    return Math.max(4096, 2 * this.latency * this.rate);
  }
}

/** Lets bytes through at a rate that can be changed, and not at all while it is paused. */
export class Throttle {
  isPaused = false;
  private bytesPerSecond = Number.POSITIVE_INFINITY;
  /** When the bytes so far may have come, in ms. */
  private due = 0;
  private wake: (() => void)[] = [];

  get rate(): number {
    return this.bytesPerSecond;
  }

  set rate(bytesPerSecond: number) {
    this.bytesPerSecond = bytesPerSecond;
    this.due = 0;
  }

  pause(): void {
    this.isPaused = true;
  }

  resume(): void {
    this.isPaused = false;
    for (const wake of this.wake.splice(0)) wake();
  }

  /** Bytes that may pass at once: a twentieth of a second of them. */
  slice(): number {
    return Number.isFinite(this.bytesPerSecond) ? Math.max(256, Math.ceil(this.bytesPerSecond / 20)) : 262144;
  }

  /** Waits until `bytes` may pass. */
  async take(bytes: number, signal: AbortSignal): Promise<void> {
    while (this.isPaused && !signal.aborted) {
      await new Promise<void>((resolve) => {
        this.wake.push(resolve);
        signal.addEventListener("abort", () => resolve(), { once: true });
      });
    }
    if (!Number.isFinite(this.bytesPerSecond)) return;
    const now = performance.now();
    this.due = Math.max(this.due, now) + (1000 * bytes) / this.bytesPerSecond;
    if (this.due > now + 1 && !signal.aborted) await sleep(this.due - now, signal).catch(() => {});
  }
}
