/** Faults of a stream (spec section 9). */

/** The code of each fault, with the section that a report of it names. */
export const FAULT_SECTIONS = {
  E_TRUNCATED: "6.2",
  E_SIGNATURE: "5.1",
  E_VERSION: "5.1",
  E_CRC: "6.3",
  E_RESERVED: "4.4",
  E_HEADER: "5.1",
  E_TIER: "8.2",
  E_CHUNK: "5.2",
  E_UNSUPPORTED: "8.1",
  E_STEP: "5.3",
  E_ALPHA: "5.4",
  E_TILE: "5.5",
  E_CHAIN: "5.6",
  E_COUNT: "5.6",
  E_AMPLIFICATION: "5.6",
  E_META: "5.8",
  E_TRAILING: "6.2",
  E_PACKET: "5.9",
  E_FRAME: "5.10",
  E_ZSTD: "5.10",
  E_SLOT: "7.2",
  E_KIND: "7.2",
  E_INDEX: "7.2",
  E_RANGE: "7.3",
  E_DIGEST: "7.7",
  E_LIMIT: "8.3",
} as const;

export type FaultCode = keyof typeof FAULT_SECTIONS;

/** A fault of the stream. `offset` is in bytes from the start of the file. */
export class StreamError extends Error {
  override readonly name = "StreamError";
  readonly section: string;

  constructor(
    readonly code: FaultCode,
    readonly offset: number,
    detail = "",
  ) {
    super(`${code} at offset ${offset}${detail && `: ${detail}`}`);
    this.section = FAULT_SECTIONS[code];
  }
}

/** A mistake of the caller, say a level that the stream does not have (spec 3.6). It is no fault of the stream. */
export class CallerError extends Error {
  override readonly name = "CallerError";
}

/** Throws the fault `code` unless `holds`. */
export function check(holds: boolean, code: FaultCode, offset: number, detail?: string): asserts holds {
  if (!holds) throw new StreamError(code, offset, detail);
}
