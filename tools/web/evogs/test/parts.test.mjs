import assert from "node:assert/strict";
import { test } from "node:test";
import { classOf, crc32, groupOf, sha256 } from "../dist/index.js";
import * as internals from "../dist/internals.js";
import { chance, rawFrame, runFrame } from "./streams.mjs";

const {
  DirtySlots,
  Workspace,
  addSiblings,
  siblingsOf,
  RangeBuffer,
  decompressFrame,
  inverseYcocg,
  quantise,
  refineSlots,
  undelta,
  unpack,
  unpackSiblings,
  unpackSigned,
  unzigzag,
} = internals;
const hex = (bytes) => Buffer.from(bytes).toString("hex");
const ascii = (text) => new TextEncoder().encode(text);

test("CRC-32 of the text that all implementations are asked (2)", () => {
  assert.equal(crc32(ascii("123456789")), 0xcbf43926);
  assert.equal(crc32(new Uint8Array(0)), 0);
  assert.equal(crc32(ascii("6789"), 0, 4, crc32(ascii("12345"))), 0xcbf43926);
});

test("SHA-256 of texts of FIPS 180-4, also piece by piece", () => {
  assert.equal(hex(sha256(ascii("abc"))), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  assert.equal(hex(sha256(ascii(""))), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  const long = ascii("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq");
  assert.equal(hex(sha256(long)), "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  const million = new Uint8Array(1e6).fill(97);
  assert.equal(hex(sha256(million)), "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
});

test("channels belong to groups and classes (3.2)", () => {
  assert.deepEqual(
    [0, 3, 7, 10, 11, 13, 14, 22, 23, 37, 38, 58].map(classOf),
    [0, 1, 2, 3, 4, 4, 5, 5, 6, 6, 7, 7],
  );
  assert.deepEqual([2, 6, 9, 10, 11, 58].map(groupOf), [0, 1, 2, 3, 4, 4]);
});

test("zigzag: 0, 1, 2, 3, 4 means 0, -1, 1, -2, 2 (7.1)", () => {
  const values = Int32Array.of(0, 1, 2, 3, 4, 2 ** 24 - 1);
  unzigzag(values, values.length);
  assert.deepEqual([...values], [0, -1, 1, -2, 2, -(2 ** 23)]);
});

test("planes: the low bits come first, then whole bytes (5.9)", () => {
  const out = new Int32Array(3);
  unpack(0x14, 3, Uint8Array.of(0x6f, 0x00, 0x04, 0x09, 0x4b), 0, out);
  assert.deepEqual([...out], [79, 150, 1200]);
  unpack(0x02, 3, Uint8Array.of(0x21), 0, out);
  assert.deepEqual([...out], [1, 0, 2]);
  unpack(0x28, 2, Uint8Array.of(1, 2, 3, 4, 5, 6), 0, out);
  assert.deepEqual([...out.subarray(0, 2)], [0x050301, 0x060402]);
});

test("signed integers of any coding are those of the stored integers (7.1)", () => {
  const random = chance(4);
  for (let round = 0; round < 200; round++) {
    const n = 1 + random(20);
    const coding = random(9) | (random(3) << 4);
    if (coding === 0) continue;
    const planes = Uint8Array.from({ length: 3 + 4 * n }, () => random(256));
    const out = new Int32Array(n);
    unpack(coding, n, planes, 3, out);
    unzigzag(out, n);
    const signed = new Int32Array(n);
    unpackSigned(coding, n, planes, 3, 7, signed);
    assert.deepEqual(
      [...signed],
      [...out].map((q) => 7 * q),
      `coding ${coding}`,
    );
  }
});

test("running sums stay within 2^28 (R-7.1-1)", () => {
  const good = Int32Array.of(2 ** 28 - 1, 1, -3);
  assert.equal(undelta(good, 3), true);
  assert.deepEqual([...good], [2 ** 28 - 1, 2 ** 28, 2 ** 28 - 3]);
  assert.equal(undelta(Int32Array.of(2 ** 28, 1), 2), false);
  assert.equal(undelta(Int32Array.of(-(2 ** 28), -1), 2), false);
});

test("YCoCg-R turned back gives every colour", () => {
  for (const [r, g, b] of [
    [27, 21, 26],
    [-7, 300, 5],
    [0, 0, 0],
    [-1, -1, 2],
  ]) {
    const co = r - b;
    const t = b + (co >> 1);
    const cg = g - t;
    const arrays = [t + (cg >> 1), co, cg].map((v) => Int32Array.of(v));
    inverseYcocg(...arrays, 1);
    assert.deepEqual(
      arrays.map((a) => a[0]),
      [r, g, b],
    );
  }
});

test("a quantiser lets through what stays within 2^28 (R-7.3-1)", () => {
  const values = Int32Array.of(4, -4, 0);
  assert.equal(quantise(values, 3, 65535, 4), true);
  assert.deepEqual([...values], [4194240, -4194240, 0]);
  assert.equal(quantise(Int32Array.of(2 ** 28), 1, 1, 0), true);
  assert.equal(quantise(Int32Array.of(2 ** 28 + 1), 1, 1, 0), false);
  assert.equal(quantise(Int32Array.of(1), 1, 65535, 24), false);
  assert.equal(quantise(Int32Array.of(0), 1, 65535, 24), true);
});

/** The second child of P = 0 is -RoundShift(a * delta, k). */
function secondOf(delta, a, k) {
  const x = new Int32Array(2);
  const column = { x, least: -(2 ** 30 - 1), most: 2 ** 30 - 1 };
  const table = { shift: k, entries: Int16Array.of(a) };
  const slots = Int32Array.of(0);
  const splits = Int32Array.of(0);
  const isGood = refineSlots(
    column,
    { slots, n: 1, splits, parents: slots, nSplits: 1, table, indices: null, first: 1 },
    Int32Array.of(delta),
  );
  return isGood ? -x[1] : null;
}

test("RoundShift: ties go toward +infinity (4.2)", () => {
  const rows = [
    [3, 1, 2],
    [5, 2, 1],
    [6, 2, 2],
    [7, 3, 1],
    [-3, 1, -1],
    [-5, 2, -1],
    [-6, 2, -1],
    [-4, 3, 0],
  ];
  for (const [v, n, expected] of rows) assert.equal(secondOf(v, 1, n) + 0, expected, `${v} by ${n}`);
});

test("products of alpha stay within 2^30 (R-7.3-2)", () => {
  assert.equal(secondOf(2 ** 28, 4, 1), null);
  assert.equal(secondOf(2 ** 28 - 1, 4, 1), 2 ** 29 - 2);
  assert.equal(secondOf(-(2 ** 15), -(2 ** 15), 0), null);
  assert.equal(secondOf(2 ** 28, 0, 12) + 0, 0);
});

test("sums of sibling differences stay within 2^28 (R-7.1-2)", () => {
  const firsts = siblingsOf(Int32Array.of(4, 7), 2, Int32Array.of(-1, -1, -1, -1, -1, -1, -1, 4), new Workspace());
  assert.deepEqual([...firsts.subarray(0, 2)], [-1, 0]);
  assert.equal(addSiblings(Int32Array.of(2 ** 28 - 1, 1), 2, firsts), true);
  assert.equal(addSiblings(Int32Array.of(2 ** 28 - 1, 2), 2, firsts), false);
  assert.equal(addSiblings(Int32Array.of(1 - 2 ** 28, 2), 2, firsts), false);
});

/** The pseudo-code of 7.1, with its dictionary. */
function addSiblingsByText(differences, slots, bornFrom) {
  const values = [];
  const place = new Map();
  slots.forEach((slot, i) => {
    place.set(slot, i);
    const first = place.get(bornFrom[slot]);
    if (first === undefined) {
      values.push(differences[i]);
    } else {
      values.push(values[first] - differences[i]);
      values[first] += differences[i];
    }
  });
  return values;
}

test("sibling differences of tiles by chance, one after the other, are those of the pseudo-code (7.1)", () => {
  const random = chance(9);
  const workspace = new Workspace();
  for (let round = 0; round < 300; round++) {
    const n = 1 + random(60);
    const bornFrom = Int32Array.from({ length: n }, (_, u) => (u > 0 && random(3) ? random(u) : -1));
    const slots = Int32Array.from(bornFrom.keys()).filter(() => random(2));
    const values = slots.map(() => random(21) - 10);
    const differences = [...values];
    const expected = addSiblingsByText(differences, [...slots], bornFrom);
    const firsts = siblingsOf(slots, slots.length, bornFrom, workspace);
    assert.equal(addSiblings(values, slots.length, firsts), true);
    assert.deepEqual([...values], expected);
    const plane = Uint8Array.from(differences, (d) => (d < 0 ? -2 * d - 1 : 2 * d));
    assert.equal(unpackSiblings(plane, slots.length, 3, firsts, values), true);
    assert.deepEqual(
      [...values],
      expected.map((value) => 3 * value),
    );
  }
});

test("frames of raw and of run-length blocks", () => {
  const content = Uint8Array.from({ length: 300000 }, (_, i) => (i * 7) & 255);
  const out = new Uint8Array(content.length);
  decompressFrame(rawFrame(content), content.length, out, 0, 0);
  assert.deepEqual(out, content);
  decompressFrame(runFrame(9, 300000), 300000, out, 0, 0);
  assert.ok(out.every((byte) => byte === 9));
  assert.throws(() => decompressFrame(rawFrame(content), 299999, out, 0, 7), { code: "E_FRAME", offset: 7 });
});

/** A frame of one compressed block with single-stream literals, a tree of these weights, and no sequence. */
function huffmanFrame(weights, stream, size) {
  const nibbles = [...weights, 0];
  const tree = [127 + weights.length];
  for (let i = 0; i < weights.length; i += 2) tree.push((nibbles[i] << 4) | nibbles[i + 1]);
  const body = [...tree, ...stream];
  const head = 2 | (size << 4) | (body.length << 14);
  const block = [head & 255, (head >> 8) & 255, head >> 16, ...body, 0];
  const blockHead = 1 | (2 << 1) | (block.length << 3);
  return Uint8Array.from([0x28, 0xb5, 0x2f, 0xfd, 0x20, size, blockHead & 255, blockHead >> 8, 0, ...block]);
}

test("a Huffman stream is consumed exactly, and its codes have at most 11 bits (RFC 8878, 4.2)", () => {
  const out = new Uint8Array(96);
  const descending = (n) => Array.from({ length: n }, (_, i) => n - i);
  const ones = [...new Array(12).fill(255), 1];
  decompressFrame(huffmanFrame(descending(11), ones, 96), 96, out, 0, 0);
  assert.ok(out.every((byte) => byte === 0));
  const tooLong = huffmanFrame(descending(12), ones, 96);
  assert.throws(() => decompressFrame(tooLong, 96, out, 0, 0), { code: "E_ZSTD" });
  const bitLeft = huffmanFrame(descending(11), [...new Array(12).fill(255), 3], 96);
  assert.throws(() => decompressFrame(bitLeft, 96, out, 0, 0), { code: "E_ZSTD" });
});

test("each of four Huffman streams is consumed exactly (QUESTIONS.md, Q1)", () => {
  const out = new Uint8Array(256);
  const streams = ["aaaaaaaaaaaaaaaa01", "aaaaaaaaaaaaaaaa01", "aaaaaaaaaaaaaaaa01", "aaaaaaaaaaaaaaaa01"];
  const frameOf = (bits) =>
    Uint8Array.from(Buffer.from(`28b52ffd60000085010006100b8010090009000900${bits.join("")}00`, "hex"));
  decompressFrame(frameOf(streams), 256, out, 0, 0);
  assert.deepEqual([...out.subarray(0, 4)], [1, 0, 1, 0]);
  for (const wrong of ["aaaaaaaaaaaaaaaa02", "aaaaaaaaaaaaaaaa00", "aaaaaaaaaaaaaa80aa"]) {
    const bits = [...streams];
    bits[1] = wrong;
    assert.throws(() => decompressFrame(frameOf(bits), 256, out, 0, 0), { code: "E_ZSTD" }, wrong);
  }
});

test("bytes may come in any order and overlap", () => {
  const random = chance(5);
  const content = Uint8Array.from({ length: 5000 }, () => random(256));
  const buffer = new RangeBuffer(content.length);
  while (buffer.filled < content.length) {
    const from = random(content.length);
    buffer.put(from, content.subarray(from, from + 1 + random(300)));
  }
  assert.deepEqual(buffer.copy(0, content.length), content);
  assert.equal(buffer.gapAfter(0), 5000);
});

test("changed slots are given once, in ranges", () => {
  const dirty = new DirtySlots();
  dirty.mark(Int32Array.of(1, 2, 40));
  dirty.markRange(60, 200);
  assert.deepEqual(dirty.take(0), [
    { start: 1, count: 2 },
    { start: 40, count: 1 },
    { start: 60, count: 140 },
  ]);
  assert.deepEqual(dirty.take(0), []);
  dirty.mark(Int32Array.of(1, 4));
  assert.deepEqual(dirty.take(2), [{ start: 1, count: 4 }]);
});
