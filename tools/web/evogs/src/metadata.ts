/** `mETa`: metadata (spec 5.8). */

import { viewOf } from "./bytes.js";
import type { Chunk } from "./chunks.js";
import { check } from "./faults.js";

const KEY = /^[a-z0-9_.-]{1,255}$/;

/** The entries in their order. Values are text from an unknown source: escape them. */
export function parseMetadata(chunk: Chunk | undefined): Map<string, string> {
  const entries = new Map<string, string>();
  if (!chunk) return entries;
  const { body, offset } = chunk;
  const view = viewOf(body);
  const utf8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
  let before = "";
  for (let at = 0; at < body.length; ) {
    check(at + 3 <= body.length, "E_META", offset);
    const valueAt = at + 3 + body[at];
    const end = valueAt + view.getUint16(at + 1, true);
    check(end <= body.length, "E_META", offset);
    const key = String.fromCharCode(...body.subarray(at + 3, valueAt));
    check(KEY.test(key), "E_META", offset, "key");
    // Keys are ASCII, so the order of strings is that of bytes.
    check(key > before, "E_META", offset, "order of keys");
    before = key;
    try {
      entries.set(key, utf8.decode(body.subarray(valueAt, end)));
    } catch {
      check(false, "E_META", offset, "a value is no UTF-8");
    }
    at = end;
  }
  return entries;
}
