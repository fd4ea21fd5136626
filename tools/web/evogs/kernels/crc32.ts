/** CRC-32 of zlib and PNG (spec 2), eight bytes at a time. */

const TABLES: usize = memory.data(8 * 256 * 4, 16);
let isReady: bool = false;

function makeTables(): void {
  for (let i: u32 = 0; i < 256; i++) {
    let c = i;
    for (let bit = 0; bit < 8; bit++) c = c & 1 ? (c >>> 1) ^ 0xedb88320 : c >>> 1;
    store<u32>(TABLES + 4 * i, c);
  }
  for (let i: u32 = 256; i < 8 * 256; i++) {
    const before = load<u32>(TABLES + 4 * (i - 256));
    store<u32>(TABLES + 4 * i, (before >>> 8) ^ load<u32>(TABLES + 4 * (before & 255)));
  }
  isReady = true;
}

/** What byte `value` does to the CRC, `places` bytes before the end of a word of eight. */
function entry(places: u32, value: u32): u32 {
  return load<u32>(TABLES + (places << 10) + ((value & 255) << 2));
}

/** The CRC-32 of the bytes from[0..n). */
export function crc32(from: usize, n: usize): u32 {
  if (!isReady) makeTables();
  const end = from + n;
  let c: u32 = 0xffffffff;
  let at = from;
  for (; at + 8 <= end; at += 8) {
    const low = load<u32>(at) ^ c;
    const high = load<u32>(at, 4);
    c =
      entry(7, low) ^
      entry(6, low >>> 8) ^
      entry(5, low >>> 16) ^
      entry(4, low >>> 24) ^
      entry(3, high) ^
      entry(2, high >>> 8) ^
      entry(1, high >>> 16) ^
      entry(0, high >>> 24);
  }
  for (; at < end; at++) c = entry(0, c ^ load<u8>(at)) ^ (c >>> 8);
  return ~c;
}
