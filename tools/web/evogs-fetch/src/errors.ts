/** Why a scene cannot be fetched. */

/**
 * - "status": the server answers with an error, say 404;
 * - "lost": there is no connection, after all retries. `run` again goes on where it stopped;
 * - "bad": header or directory have a fault. It is `cause`, a StreamError;
 * - "short": the file on the server ends before its directory says so;
 * - "changed": it is another file than before;
 * - "range": the answer is not the range that was asked for.
 */
export type FetchFailure = "status" | "lost" | "bad" | "short" | "changed" | "range";

export class FetchError extends Error {
  override readonly name = "FetchError";

  constructor(
    readonly kind: FetchFailure,
    message: string,
    readonly status = 0,
    cause?: unknown,
  ) {
    super(message, { cause });
  }
}
