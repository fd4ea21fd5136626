/** Views of bytes. All integers of a stream and of a dump are little-endian (spec 4.2). */

const probe = new Uint8Array(new Uint16Array([1]).buffer);
if (probe[0] !== 1) throw new Error("this decoder needs a little-endian machine");

export function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

/** The bytes of integers, without a copy. */
export function bytesOf(array: Int32Array): Uint8Array {
  return new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
}

/** An unsigned 64-bit integer. It is exact below 2^53, and the nearest double above. */
export function u64(view: DataView, at: number): number {
  return view.getUint32(at, true) + view.getUint32(at + 4, true) * 2 ** 32;
}
