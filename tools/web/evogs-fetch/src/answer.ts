/** One request, and what the server says. */

import { FetchError } from "./errors.js";

/** What the first answer said of the file. What a server does not tell is null. */
export interface FileIdentity {
  size: number | null;
  tag: string | null;
}

export interface Answer {
  /** Where its first byte stands in the file. */
  start: number;
  /** The server does not serve ranges: it sends the whole file. */
  isWhole: boolean;
  identity: FileIdentity;
  body: ReadableStreamDefaultReader<Uint8Array>;
}

/** Answers that may be better the next time. */
const TRANSIENT = new Set([408, 425, 429, 500, 502, 503, 504]);

/** A failure after which the same request is tried again. */
export class Transient extends Error {
  constructor(
    message: string,
    /** How long the server asks to wait, in seconds. */
    readonly retryAfter = 0,
    readonly status = 0,
  ) {
    super(message);
  }
}

/** What an answer means that has an error for its status. */
export function refusal({ status, statusText, headers }: Response): Transient | FetchError {
  if (TRANSIENT.has(status))
    return new Transient(`the server answers ${status}`, Number(headers.get("retry-after")) || 0, status);
  return new FetchError("status", `the server answers ${status} ${statusText}`.trim(), status);
}

/** Aborts a request whose bytes do not come. */
export class Stall {
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly abort: AbortController,
    private readonly seconds = 20,
  ) {
    this.start();
  }

  start(): void {
    this.end();
    this.timer = setTimeout(() => this.abort.abort(new Transient("no answer")), 1000 * this.seconds);
  }

  end(): void {
    clearTimeout(this.timer);
  }
}

/** How long to wait before the next try, in ms, after so many failures in a row. */
export function waitAfter(failures: number, { retryAfter }: Transient, backOff = 500): number {
  const wait = backOff * 2 ** Math.min(4, failures - 1) * (0.75 + 0.5 * Math.random());
  return Math.max(wait, 1000 * Math.min(60, retryAfter));
}

/** Asks for bytes start .. end - 1. Throws a FetchError, a Transient, or the reason of `signal`. */
export async function ask(
  url: string,
  start: number,
  end: number,
  signal: AbortSignal,
  fetchImpl: typeof fetch,
  cache: RequestCache,
): Promise<Answer> {
  let response: Response;
  try {
    const headers = { Range: `bytes=${start}-${end - 1}` };
    response = await fetchImpl(url, { headers, signal, cache });
  } catch (error) {
    signal.throwIfAborted();
    throw new Transient(String(error));
  }
  const { status, headers } = response;
  if (status !== 200 && status !== 206) {
    void response.body?.cancel().catch(() => {});
    if (status === 416) throw new FetchError("short", `the file ends before byte ${start}`, status);
    throw refusal(response);
  }
  if (response.body === null) throw new Transient("an answer without a body");
  const isWhole = status === 200;
  // Other origins may hide Content-Range: then the range is taken to be the one that was asked for.
  const range = /^bytes (\d+)-\d+\/(\d+|\*)$/.exec(headers.get("content-range") ?? "");
  if (!isWhole && range !== null && Number(range[1]) !== start) {
    void response.body.cancel().catch(() => {});
    throw new FetchError("range", `asked for byte ${start}, and got byte ${range[1]}`);
  }
  const length = isWhole ? headers.get("content-length") : range?.[2];
  const size = length && /^\d+$/.test(length) && !headers.get("content-encoding") ? Number(length) : null;
  const tag = headers.get("etag");
  return { start: isWhole ? 0 : start, isWhole, identity: { size, tag }, body: response.body.getReader() };
}
