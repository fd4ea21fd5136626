/** The verdicts of conformance/README.md. It reads and writes no file, and runs in browsers too. */

import { CallerError, Decoder, StreamError, decode } from "../dist/index.js";

export const ACCEPTED = 0;
export const REJECTED = 1;
export const MISUSED = 2;
export const INCOMPLETE = 3;
export const OVER_LIMIT = 4;
export const UNSUPPORTED = 127;

function ofFault(fault) {
  const exit = { E_LIMIT: OVER_LIMIT, E_UNSUPPORTED: UNSUPPORTED }[fault.code] ?? REJECTED;
  return { exit, code: fault.code, offset: fault.offset };
}

function judgeProgressively({ arrival, dump_on_fault, ...options }, bytes) {
  const decoder = new Decoder(options);
  for (const [offset, size] of arrival ?? [[0, bytes.length]]) {
    decoder.put(offset, bytes.subarray(offset, offset + size));
  }
  const { kind, fault } = decoder.end();
  const { scene } = decoder;
  if (fault) return { ...ofFault(fault), scene: dump_on_fault ? scene : null };
  return { exit: kind === "complete" ? ACCEPTED : INCOMPLETE, scene };
}

/**
 * The exit status of a request for `bytes`, with the fault if there is one, and the scene whose dump is wanted.
 * Limits and the arrival are those of the request, not files of them.
 */
export function judge({ mode, level, limits, verify, arrival, dump_on_fault }, bytes) {
  const options = { level: level ?? undefined, limits: limits ?? undefined, verify };
  try {
    if (mode === "progressive") return judgeProgressively({ ...options, arrival, dump_on_fault }, bytes);
    return { exit: ACCEPTED, scene: decode(bytes, options) };
  } catch (error) {
    if (error instanceof StreamError) return { ...ofFault(error), scene: null };
    if (error instanceof CallerError) return { exit: MISUSED, scene: null };
    throw error;
  }
}
