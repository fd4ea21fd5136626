/** Fetches a scene: the directory first, then packets by priority, each byte once. */

import { type Decoder, HEADER_SIZE } from "evogs";
import { type Answer, type FileIdentity, Stall, Transient, ask, waitAfter } from "./answer.js";
import { FetchError } from "./errors.js";
import { type ByteRange, Intervals } from "./intervals.js";
import { type Order, fileOrder } from "./order.js";
import { Pace, Throttle, sleep } from "./pace.js";
import { nextRanges } from "./ranges.js";

export interface FetchOptions {
  /** The packets that are wanted, in order. The order of the file if it is absent. */
  order?: Order;
  /** Called after bytes were given to the decoder. */
  onBytes?: () => void;
  /** Called when `state` changes. */
  onState?: () => void;
  /** Bytes for each second at most. */
  bytesPerSecond?: number;
  /** Failures in a row, without a byte in between, after which `run` gives up. */
  retries?: number;
  /** An answer without a byte for so long is given up, in seconds. */
  stallSeconds?: number;
  /** The first wait before another try, in ms. It doubles each time, up to 16 times as long. */
  backOff?: number;
  fetch?: typeof fetch;
  /** "no-store" without it: caches of browsers make requests for parts of one file wait for each other. */
  cache?: RequestCache;
}

/**
 * - "loading": bytes come, or are asked for;
 * - "waiting": after a failure, until bytes come again: before another try and during it;
 * - "stopped": `run` ended, because all is there, by `stop`, or with an error.
 */
export type FetchState = "stopped" | "loading" | "waiting";

/** The first request. Its answer has the directory of most files. */
const FIRST = 65536;
const MOST_REQUESTS = 2;
/** Less than this is not cancelled: it would take longer to ask again. */
const WORTH_CANCELLING = 65536;

interface Request {
  range: ByteRange;
  /** Where its next byte belongs. */
  at: number;
  abort: AbortController;
  done: Promise<Outcome>;
}

type Outcome = { request: Request | null; error: unknown };

/**
 * Fetches what is wanted of a file and gives it to a decoder.
 *
 * `run` resolves when all that is wanted is there, and throws a FetchError if that cannot be. Either way it
 * can be called again, and goes on where it stopped. Faults of packets stop nothing: see `decoder.fault`.
 */
export class SceneFetch {
  state: FetchState = "stopped";
  /** Requests so far. */
  requests = 0;
  /** Bytes that came more than once: 0, unless a server without ranges lost the connection. */
  repeated = 0;
  /** The connection failed so, and no byte came since then: also in the next `run`. */
  failure: Error | null = null;
  /** The server sends the file as a whole. */
  isSequential = false;
  private readonly came = new Intervals();
  private readonly throttle = new Throttle();
  private readonly pace = new Pace();
  private readonly inFlight = new Set<Request>();
  private order: Order;
  /** The packets of `order`, once the directory is there. */
  private wanted: ArrayLike<number> | null = null;
  private queue: ByteRange[] = [];
  private identity: FileIdentity | null = null;
  private failures = 0;
  private running: AbortController | null = null;
  private replan: (() => void) | null = null;

  constructor(
    readonly url: string,
    private readonly decoder: Decoder,
    private readonly options: FetchOptions = {},
  ) {
    this.order = options.order ?? fileOrder();
    this.throttle.rate = options.bytesPerSecond ?? Number.POSITIVE_INFINITY;
  }

  /** Bytes that came. */
  get received(): number {
    return this.came.total;
  }

  /** Bytes of the whole file, once the directory is there. */
  get size(): number | null {
    return this.decoder.directory?.packets.end ?? null;
  }

  /** Bytes for each second, as they were measured. */
  get measuredRate(): number {
    return this.pace.rate;
  }

  set bytesPerSecond(rate: number) {
    this.throttle.rate = rate;
  }

  get isPaused(): boolean {
    return this.throttle.isPaused;
  }

  pause(): void {
    this.throttle.pause();
  }

  resume(): void {
    this.throttle.resume();
  }

  /** Wants other packets, or in another order. What is on its way and not wanted any more is cancelled. */
  want(order: Order): void {
    this.order = order;
    this.wanted = null;
    this.queue = [];
    const directory = this.decoder.directory;
    if (directory === null || this.isSequential) return;
    for (const { at, range, abort } of this.inFlight) {
      const left = range.end - at;
      if (left <= WORTH_CANCELLING) continue;
      // Its next bytes must be among those that are wanted first.
      const urgent = this.wantedRanges(left / 2, this.came);
      if (!urgent.some(({ start, end }) => start < at + WORTH_CANCELLING && at < end)) abort.abort(CANCELLED);
    }
    this.replan?.();
  }

  /** Ends `run`. What came stays. */
  stop(): void {
    this.running?.abort(CANCELLED);
  }

  async run(): Promise<void> {
    if (this.running !== null) throw new Error("it runs already");
    this.running = new AbortController();
    const { signal } = this.running;
    this.failures = 0;
    this.setState(this.failure === null ? "loading" : "waiting");
    try {
      while (!signal.aborted) {
        this.launch(signal);
        if (this.inFlight.size === 0) break;
        const { request, error } = await this.next();
        if (request !== null) this.inFlight.delete(request);
        if (error) await this.retryLater(error, signal);
      }
    } catch (error) {
      if (error !== CANCELLED) throw error;
    } finally {
      for (const request of this.inFlight) request.abort.abort(CANCELLED);
      await Promise.all([...this.inFlight].map(({ done }) => done));
      this.inFlight.clear();
      this.queue = [];
      this.running = null;
      this.setState("stopped");
    }
  }

  /** Sends requests while there is something to ask for. */
  private launch(signal: AbortSignal): void {
    while (this.inFlight.size < MOST_REQUESTS && !signal.aborted) {
      if (this.inFlight.size > 0 && !this.isNearEnd()) return;
      const range = this.nextRange();
      if (range === null) return;
      const abort = new AbortController();
      const stop = () => abort.abort(CANCELLED);
      signal.addEventListener("abort", stop, { once: true });
      const request: Request = {
        range,
        at: range.start,
        abort,
        done: Promise.resolve({ request: null, error: null }),
      };
      this.inFlight.add(request);
      request.done = this.load(request)
        .then(
          () => ({ request, error: null }),
          (error) => ({ request, error: error === CANCELLED ? null : error }),
        )
        .finally(() => signal.removeEventListener("abort", stop));
    }
  }

  /** The next request that ends; or none, when what is wanted has changed or a request is near its end. */
  private next(): Promise<Outcome> {
    const changed = new Promise<Outcome>((resolve) => {
      this.replan = () => resolve({ request: null, error: null });
    });
    return Promise.race([changed, ...[...this.inFlight].map(({ done }) => done)]);
  }

  /** Whether so little is on its way that the next request may be sent. */
  private isNearEnd(): boolean {
    if (this.decoder.directory === null || this.isSequential || Number.isFinite(this.throttle.rate)) return false;
    let left = 0;
    for (const { at, range } of this.inFlight) left += range.end - at;
    return left <= this.pace.ahead();
  }

  private nextRange(): ByteRange | null {
    const { header, directory } = this.decoder;
    if (this.isSequential) {
      const end = this.wantedEnd();
      return this.inFlight.size === 0 && !this.came.has(0, end)
        ? { start: this.came.missing(0, end)[0].start, end }
        : null;
    }
    if (directory === null) {
      if (this.inFlight.size > 0) return null;
      const end = header === null ? FIRST : Math.max(FIRST, HEADER_SIZE + header.chunksSize);
      const [gap] = this.came.missing(0, end);
      if (gap === undefined) throw new FetchError("short", "the file ends before its directory does");
      return { start: gap.start, end };
    }
    if (this.queue.length === 0) this.queue = this.wantedRanges(this.pace.requestSize(), this.claimed());
    return this.queue.shift() ?? null;
  }

  private wantedPackets(): ArrayLike<number> {
    const { directory } = this.decoder;
    if (directory === null) return [];
    this.wanted ??= this.order(directory);
    return this.wanted;
  }

  private wantedRanges(size: number, claimed: Intervals): ByteRange[] {
    const { directory } = this.decoder;
    return directory === null ? [] : nextRanges(directory.packets, this.wantedPackets(), claimed, size);
  }

  /** Where the last wanted packet ends. */
  private wantedEnd(): number {
    const { directory } = this.decoder;
    if (directory === null) return Number.MAX_SAFE_INTEGER;
    const wanted = this.wantedPackets();
    let end = 0;
    for (let k = 0; k < wanted.length; k++) {
      end = Math.max(end, directory.packets.offset[wanted[k]] + directory.packets.size[wanted[k]]);
    }
    return end;
  }

  /** Bytes that came or are on their way. */
  private claimed(): Intervals {
    const all = this.came.copy();
    for (const { at, range } of this.inFlight) all.add(at, range.end);
    return all;
  }

  /** Sends a request and gives its bytes to the decoder. Rejects with a FetchError or a Transient. */
  private async load(request: Request): Promise<void> {
    const { range, abort } = request;
    const stall = new Stall(abort, this.options.stallSeconds);
    const asked = performance.now();
    let answer: Answer | null = null;
    try {
      this.requests++;
      const { fetch: fetchImpl = fetch, cache = "no-store" } = this.options;
      answer = await ask(this.url, range.start, range.end, abort.signal, fetchImpl, cache);
      const answered = performance.now();
      this.pace.answered((answered - asked) / 1000);
      this.identify(answer, request);
      let bytes = 0;
      for (;;) {
        stall.start();
        const part = await answer.body.read();
        stall.end();
        if (part.done) break;
        bytes += part.value.length;
        this.failures = 0;
        this.failure = null;
        this.setState("loading");
        await this.take(request, part.value);
        if (this.isSequential && this.came.has(0, this.wantedEnd())) return;
        if (!this.isSequential && request.at >= range.end) break;
        if (this.isNearEnd()) this.replan?.();
      }
      if (!Number.isFinite(this.throttle.rate)) this.pace.received(bytes, (performance.now() - answered) / 1000);
      this.checkEnd(request);
    } catch (error) {
      if (abort.signal.aborted) throw abort.signal.reason;
      if (error instanceof FetchError || error instanceof Transient) throw error;
      // Readers of bodies reject with a TypeError when the connection is lost.
      throw new Transient(String(error));
    } finally {
      stall.end();
      void answer?.body.cancel().catch(() => {});
    }
  }

  /** Notes what file it is, and refuses another one. */
  private identify(answer: Answer, request: Request): void {
    const { identity } = answer;
    const known = this.identity;
    if (known !== null) {
      const isOther =
        (known.size !== null && identity.size !== null && known.size !== identity.size) ||
        (known.tag !== null && identity.tag !== null && known.tag !== identity.tag);
      if (isOther) throw new FetchError("changed", "the file on the server is another one than before");
    }
    this.identity = known ?? identity;
    if (answer.isWhole) {
      this.isSequential = true;
      request.at = 0;
      request.range = { start: 0, end: Number.MAX_SAFE_INTEGER };
    }
  }

  /** Gives bytes to the decoder, at the pace that was asked for. All that came is given: none is asked for again. */
  private async take(request: Request, bytes: Uint8Array): Promise<void> {
    const { signal } = request.abort;
    for (let from = 0; from < bytes.length; ) {
      const part = bytes.subarray(from, from + this.throttle.slice());
      await this.throttle.take(part.length, signal);
      const { at } = request;
      // Bytes that the server sends beyond the range are not taken.
      const end = Math.min(at + part.length, request.range.end);
      const before = this.came.total;
      this.decoder.put(at, part.subarray(0, end - at));
      this.came.add(at, end);
      this.repeated += end - at - (this.came.total - before);
      request.at = end;
      from += part.length;
      const { directory, fault } = this.decoder;
      if (directory === null && fault !== null) {
        throw new FetchError("bad", `this is no EvoGS file that can be shown: ${fault.message}`, 0, fault);
      }
      this.options.onBytes?.();
    }
  }

  /** An answer that ended before its range did: the file ends, or the connection was lost. */
  private checkEnd({ at, range }: Request): void {
    if (!this.isSequential && at >= range.end) return;
    const size = this.identity?.size ?? null;
    const { directory } = this.decoder;
    const isEnd = size === null ? this.isSequential : at >= size;
    if (!isEnd) throw new Transient("the answer ended early");
    if (directory === null) throw new FetchError("short", "the file ends before its directory does");
    if (at < directory.packets.end) {
      throw new FetchError("short", `the file ends at byte ${at} of ${directory.packets.end}`);
    }
  }

  /** Waits before the next try, or throws what cannot be tried again. */
  private async retryLater(error: unknown, signal: AbortSignal): Promise<void> {
    if (!(error instanceof Transient)) throw error;
    this.failures++;
    this.failure = error;
    if (this.failures > (this.options.retries ?? 6)) {
      throw new FetchError("lost", error.message, error.status, error);
    }
    // Other requests would wait for the same server; what they got stays.
    this.queue = [];
    this.setState("waiting");
    await sleep(waitAfter(this.failures, error, this.options.backOff), signal);
  }

  private setState(state: FetchState): void {
    if (this.state === state) return;
    this.state = state;
    this.options.onState?.();
  }
}

/** The reason of requests that are not wanted any more. */
const CANCELLED = new Error("cancelled");
