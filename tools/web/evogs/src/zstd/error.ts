/** The content of a frame breaks RFC 8878 (E_ZSTD, spec 5.10). Who knows the packet turns it into a StreamError. */
export class ZstdError extends Error {
  override readonly name = "ZstdError";
}

export function corrupt(what: string): never {
  throw new ZstdError(what);
}
