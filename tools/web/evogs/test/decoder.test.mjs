import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { CallerError, Decoder, decode, dump, floatView, sha256, shownPicks, slotFloats } from "../dist/index.js";
import { CORE, PALETTE, PICKS, chance, core, packet, stream } from "./streams.mjs";

const spec = (name) => new Uint8Array(readFileSync(new URL(`../../../../spec/${name}`, import.meta.url)));
const hex = (bytes) => Buffer.from(bytes).toString("hex");

/** The SHA-256 of the dumps, as Annex A gives them. */
const EXAMPLES = {
  "example.evogs": [272, "4de996da8594b18dfb9c44edc6bb21bd5080717916cdf0f84639dc1293a118b6"],
  "example-2.evogs": [723, "7d559f98430b176612924284cd350fd5eb06218aa43fecd546bfabad3d5ec9ac"],
};

for (const [name, [size, digest]] of Object.entries(EXAMPLES)) {
  test(`${name} of Annex A, as a whole`, () => {
    const bytes = dump(decode(spec(name), { verify: true }));
    assert.equal(bytes.length, size);
    assert.equal(hex(sha256(bytes)), digest);
  });

  test(`${name} of Annex A, a byte at a time and in any order`, () => {
    const file = spec(name);
    const random = chance(file.length);
    const order = Array.from(file, (_, i) => i);
    for (const isShuffled of [false, true]) {
      if (isShuffled) order.sort(() => random(2) - 0.5);
      const decoder = new Decoder({ verify: true });
      for (const at of order) decoder.put(at, file.subarray(at, at + 1));
      assert.equal(decoder.end().kind, "complete");
      assert.equal(hex(sha256(dump(decoder.scene))), digest);
    }
  });
}

test("the float view of slot 3 of example 1 (7.6)", () => {
  const view = floatView(decode(spec("example.evogs")));
  const last = view.map((channel) => channel[channel.length - 1]);
  assert.deepEqual(
    last,
    [
      9.228515625, 0.2265625, 0.0537109375, 1, 0, 0, 0, -6.09375, -5.90625, -6.9375, 2.5, 0.9140625, 0.8515625,
      0.7265625,
    ],
  );
  assert.ok(view.every((channel) => channel.length === 3));
});

test("picks that come late are those of the ancestor (7.5)", () => {
  const scene = decode(spec("example-2.evogs"));
  assert.deepEqual([...shownPicks(scene, 0)], [2, 0, 0, 2, 0]);
  assert.equal(slotFloats(scene, 0, 14, 3, 4)[0], Math.fround(-36 / 128));
});

test("levels, and levels that are not there (3.6)", () => {
  const file = spec("example.evogs");
  assert.equal(decode(file, { level: 0 }).tile(0).nSlots, 3);
  assert.throws(() => decode(file, { level: 2 }), CallerError);
  const decoder = new Decoder({ level: 2 });
  assert.throws(() => decoder.feed(file), CallerError);
});

test("limits of the caller (8.3)", () => {
  const file = spec("example.evogs");
  assert.throws(() => decode(file, { limits: { slots: 3 } }), { code: "E_LIMIT", offset: 207 });
  assert.equal(decode(file, { limits: { slots: 4 } }).splatCount(), 3);
});

test("a file that ends early is cut short, but no fault of a decoder that waits for more (6.2, 6.4)", () => {
  const file = spec("example.evogs").subarray(0, 500);
  assert.throws(() => decode(file), { code: "E_TRUNCATED", offset: 457 });
  const decoder = new Decoder();
  decoder.feed(file);
  assert.equal(decoder.fault, null);
  assert.equal(decoder.end().kind, "partial");
  assert.equal(decoder.scene.tile(0).nSlots, 3);
  assert.deepEqual(decoder.progress, { applied: 1, packets: 2 });
});

test("changes name the slots that a step touched", () => {
  const file = spec("example.evogs");
  const decoder = new Decoder();
  decoder.feed(file.subarray(0, 457));
  assert.deepEqual(decoder.takeChanges(), [{ tile: 0, component: CORE, ranges: [{ start: 0, count: 3 }] }]);
  decoder.feed(file.subarray(457));
  assert.deepEqual(decoder.takeChanges(), [{ tile: 0, component: CORE, ranges: [{ start: 0, count: 4 }] }]);
  assert.deepEqual(decoder.takeChanges(), []);
});

const ADDS = 21;
const PSI = 7;

/** Adds at x = 1, 2, 3. Each refine adds 1 to x, and to the opacity of slot 2 what 24 bits can hold. */
const THREE_ADDS = { adds: 3, bytes: core({ [ADDS]: [0x08, [2, 4, 6]] }) };
const REFINE_ALL = {
  refines: 3,
  bytes: core({ [PSI]: [0x08, [2, 2, 2]], [PSI + 10]: [0x28, [0, 0, 254, 0, 0, 255, 0, 0, 255], 3] }),
};

test("a packet whose last number is out of range changes nothing (R-6.4-5)", () => {
  // 128 times 2^23 - 1 is below 2^30 - 1, and 129 times is above.
  const rows = [THREE_ADDS, ...new Array(130).fill(REFINE_ALL)];
  const decoder = new Decoder();
  decoder.feed(stream({ rows }));
  assert.equal(decoder.fault?.code, "E_RANGE");
  assert.equal(decoder.end().kind, "fault");
  const { core: numbers } = decoder.scene.tile(0);
  assert.deepEqual(decoder.progress, { applied: 129, packets: 131 });
  assert.deepEqual([...numbers.channel(0)], [129, 130, 131]);
  assert.deepEqual([...numbers.channel(10)], [0, 0, 128 * (2 ** 23 - 1)]);
});

/** A tile in which slots 7 and 12 were born from slot 4, and slot 9 from slot 7, as in the example of 7.1. */
const FAMILY = [
  { adds: 7, bytes: core({}) },
  { splits: 1, bytes: core({ 0: [0x04, [4]] }) },
  { adds: 1, bytes: core({}) },
  { splits: 1, bytes: core({ 0: [0x04, [7]] }) },
  { adds: 2, bytes: core({}) },
  { splits: 1, bytes: core({ 0: [0x04, [4]] }) },
];
/** The gaps of slots 4, 7, 9, 12. */
const GAPS = [0x08, [4, 2, 1, 2]];

test("sibling differences: the example of 7.1", () => {
  const bytes = core({ 0: GAPS, [PSI]: [0x48, [20, 6, 2, 4]] });
  const x = decode(stream({ rows: [...FAMILY, { refines: 4, bytes }] }))
    .tile(0)
    .core.channel(0);
  assert.deepEqual([x[4], x[7], x[9], x[12]], [15, 8, 6, 11]);
  const without4 = core({ 0: [0x08, [7, 1, 2]], [PSI]: [0x48, [20, 6, 2]] });
  const y = decode(stream({ rows: [...FAMILY, { refines: 3, bytes: without4 }] }))
    .tile(0)
    .core.channel(0);
  assert.deepEqual([y[7], y[9], y[12]], [13, 7, 1]);
});

test("sibling differences come behind YCoCg-R, by the coding byte of each channel (7.1)", () => {
  // Y 4 0 0 0, Co 0 2 0 0, Cg 0: the triples are 4 4 4 for slot 4, and 1 0 -1 for slot 7.
  const lists = { 0: GAPS, [PSI + 11]: [0x48, [8, 0, 0, 0]], [PSI + 12]: [0x08, [0, 4, 0, 0]] };
  const scene = decode(stream({ rows: [...FAMILY, { refines: 4, bytes: core(lists, 1) }] }));
  const [r, g, b] = [11, 12, 13].map((k) => scene.tile(0).core.channel(k));
  assert.deepEqual([r[4], r[7], r[9], r[12]], [5, 3, 3, 5]);
  assert.deepEqual([g[4], g[7], g[9], g[12]], [4, 0, 0, 0]);
  assert.deepEqual([b[4], b[7], b[9], b[12]], [4, -1, 0, 0]);
});

test("sibling differences are only for steps of refines (R-5.9-3)", () => {
  const withDrop = core({ 0: [0x04, [0x00]], 1: [0x02, [0x08]], [PSI]: [0x48, [2]] });
  const rows = [
    { adds: 3, bytes: core({}) },
    { refines: 1, drops: 1, bytes: withDrop },
  ];
  assert.throws(() => decode(stream({ rows })), { code: "E_PACKET" });
  const withAdd = core({ [PSI]: [0x48, [2]], [ADDS]: [0x48, [2]] });
  const good = [
    { adds: 3, bytes: core({}) },
    { refines: 1, adds: 1, bytes: withAdd },
  ];
  assert.deepEqual(
    [
      ...decode(stream({ rows: good }))
        .tile(0)
        .core.channel(0),
    ],
    [1, 0, 0, 1],
  );
});

test("a packet with sibling differences that has a fault changes nothing (R-6.4-5)", () => {
  const good = { refines: 4, bytes: core({ 0: GAPS, [PSI]: [0x48, [20, 6, 2, 4]] }) };
  const top = [0x68, [0, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255], 3];
  const wide = { refines: 4, bytes: core({ 0: GAPS, [PSI]: [0x48, [20, 6, 2, 4]], [PSI + 10]: top }) };
  const decoder = new Decoder();
  decoder.feed(stream({ rows: [...FAMILY, good, ...new Array(300).fill(wide)] }));
  assert.equal(decoder.end().fault.code, "E_RANGE");
  const n = decoder.progress.applied - FAMILY.length;
  assert.ok(n > 1 && n < 300);
  const x = decoder.scene.tile(0).core.channel(0);
  assert.deepEqual([x[4], x[7], x[9], x[12]], [15 * n, 8 * n, 6 * n, 11 * n]);
});

/** A list of `n` integers by chance, of some coding; `delta` is its bit of sums and differences, or 0. */
function listByChance(random, n, delta) {
  const codings = [
    [0x08, n, 1],
    [0x10, n, 1],
    [0x04, (n + 1) >> 1, 1],
    [0x18, 2 * n, 2],
    [0x20, 2 * n, 2],
    [0x14, ((n + 1) >> 1) + n, 2],
  ];
  const [coding, size, count] = codings[random(codings.length)];
  const plane = Uint8Array.from({ length: size }, () => random(256));
  // A byte of the low plane may hold half of an integer that is not there.
  if ((coding & 15) === 4 && n & 1) plane[(n - 1) >> 1] &= 15;
  return [coding | (random(2) ? delta : 0), plane, count];
}

const N_BAND = 9;

/** Lists of `n` integers from `first` on, some of them left out. */
function listsByChance(random, first, count, n, delta) {
  const lists = {};
  for (let k = 0; k < count; k++) if (random(4)) lists[first + k] = listByChance(random, n, delta);
  return lists;
}

/** Two tiles with an SH band: adds, splits of all, then packets that refine slots by chance. */
function refinedByChance(random, mantissa) {
  const rows = [];
  const step = (tile, counts, psi, lists) => {
    const n = psi ? (counts.splits ?? counts.refines) : counts.adds;
    const flags = psi ? random(2) : 2 * random(2);
    const bits = psi && !counts.refines ? 0 : 0x40;
    const ofCore = listsByChance(random, psi ? PSI : ADDS, 14, n, bits);
    rows.push({ tile, ...counts, bytes: core({ ...lists, ...ofCore }, flags) });
    const bytes = packet(2 * N_BAND, listsByChance(random, psi ? 0 : N_BAND, N_BAND, n, bits), flags);
    rows.push({ tile, component: 1, ...counts, bytes });
  };
  const n = 20 + random(30);
  for (const tile of [0, 1]) step(tile, { adds: n }, false, {});
  for (const tile of [0, 1]) step(tile, { splits: n }, true, {});
  for (let k = 0; k < 12; k++) {
    const gaps = [];
    for (let slot = -1; ; ) {
      const gap = random(4);
      slot += gap + 1;
      if (slot >= 2 * n) break;
      gaps.push(gap);
    }
    step(random(2), { refines: gaps.length }, true, { 0: [0x08, gaps] });
  }
  const ofBands = ({ component }) => component === 1;
  const plain = rows.map((row) => (ofBands(row) ? { tile: row.tile, component: 1, bytes: row.bytes } : row));
  return stream({ nTiles: 2, shDegree: 1, rows: plain, mantissa });
}

test("a whole file, whose packets are applied tile by tile and several at once, is what they are one by one", () => {
  const random = chance(22);
  for (let round = 0; round < 40; round++) {
    const file = refinedByChance(random, 1 + random(300));
    const decoder = new Decoder();
    decoder.feed(file);
    assert.equal(decoder.end().kind, "complete", decoder.fault?.message);
    assert.equal(hex(sha256(dump(decode(file)))), hex(sha256(dump(decoder.scene))));
  }
});

test("the first fault is that of the file, where tiles are decoded one after the other (6.1)", () => {
  const adds = (tile) => ({ tile, adds: 3, bytes: core({}) });
  const beyond = core({ 0: [0x08, [9]], [PSI]: [0x08, [2]] });
  const reserved = core({ 0: [0x08, [0]], [PSI]: [0x80, [2]] });
  const rows = [
    adds(0),
    adds(1),
    { tile: 1, refines: 1, bytes: beyond },
    { tile: 0, refines: 1, bytes: reserved },
  ];
  const file = stream({ nTiles: 2, rows });
  const offset = file.length - reserved.length - beyond.length;
  assert.throws(() => decode(file), { code: "E_SLOT", offset });
  const many = new Array(4).fill({ refines: 1, bytes: core({ 0: [0x08, [0]], [PSI]: [0x08, [2]] }) });
  const late = stream({ rows: [adds(0), ...many, { refines: 1, bytes: beyond }] });
  assert.throws(() => decode(late), { code: "E_SLOT", offset: late.length - beyond.length });
});

test("products of sibling differences stay within 2^28 where the differences do (R-7.3-1)", () => {
  // The largest Delta is that of slot 7: 127 and 127 again, each times 2^16 - 1, and then times a sum of 34 steps.
  const bytes = core({ 0: [0x08, [4, 2]], [PSI + 10]: [0x68, [254, 254, 255, 255, 63, 63], 3] });
  const rows = [...FAMILY, { refines: 2, bytes }];
  assert.throws(() => decode(stream({ rows, mantissa: 65535 })), { code: "E_RANGE" });
  const small = core({ 0: [0x08, [4, 2]], [PSI + 10]: [0x48, [254, 253]] });
  const scene = decode(stream({ rows: [...FAMILY, { refines: 2, bytes: small }], mantissa: 65535 }));
  const numbers = scene.tile(0).core.channel(10);
  assert.deepEqual([numbers[4], numbers[7]], [0, 254 * 65535]);
});

test("a file of 100 kB with as many records as it may have takes memory and time in proportion (8.3)", () => {
  const plane = new Uint8Array(100000).map((_, i) => i & 1);
  const size = core({ [ADDS]: [0x01, plane] }).length;
  const adds = Math.min(16 * size, 8 * plane.length);
  const rows = [{ adds, bytes: core({ [ADDS]: [0x01, plane] }) }];
  for (let band = 1; band <= 3; band++) rows.push({ component: band });
  const began = performance.now();
  const scene = decode(stream({ shDegree: 3, rows }));
  assert.equal(scene.splatCount(), 800000);
  assert.ok(performance.now() - began < 10000);
});

test("counts that no bytes pay for take no memory (8.3)", () => {
  const rows = [{ adds: 30000, bytes: core({}) }];
  assert.throws(() => decode(stream({ rows })), { code: "E_AMPLIFICATION" });
  // The table says 16 million slots in a packet of a megabyte. Only its beginning comes, or it holds no list.
  const file = stream({ rows: [{ adds: 16000000, bytes: new Uint8Array(1000000) }] });
  const before = process.memoryUsage().arrayBuffers;
  const decoder = new Decoder();
  decoder.feed(file.subarray(0, 5000));
  assert.equal(decoder.end().kind, "partial");
  assert.throws(() => decode(file), { code: "E_PACKET" });
  assert.ok(process.memoryUsage().arrayBuffers - before < 1e7);
});

test("many small tiles", () => {
  const rows = [];
  for (let tile = 0; tile < 20000; tile++) {
    rows.push({ tile, adds: 1, bytes: core({ [ADDS]: [0x08, [tile & 255]] }) });
    for (let band = 1; band <= 3; band++) rows.push({ tile, component: band });
  }
  const file = stream({ nTiles: 20000, shDegree: 3, rows });
  const decoder = new Decoder();
  for (let at = 0; at < file.length; at += 1000) decoder.feed(file.subarray(at, at + 1000));
  assert.equal(decoder.end().kind, "complete");
  assert.deepEqual(sha256(dump(decoder.scene)), sha256(dump(decode(file))));
});

test("picks wait for the palette, and the palette for nothing but itself (12.2)", () => {
  const rows = [
    { adds: 2, bytes: core({}) },
    { component: PALETTE, adds: 1, bytes: packet(9, { 0: [0x08, [2]] }) },
    { component: PICKS, bytes: packet(1, { 0: [0x01, [3]] }) },
  ];
  const file = stream({ shDegree: 1, hasPalette: true, rows });
  const whole = dump(decode(file));
  const sizes = rows.map((row) => row.bytes.length);
  const start = file.length - sizes[0] - sizes[1] - sizes[2];
  const decoder = new Decoder();
  decoder.put(0, file.subarray(0, start + sizes[0]));
  decoder.put(file.length - sizes[2], file.subarray(file.length - sizes[2]));
  assert.equal(decoder.progress.applied, 1);
  decoder.put(start, file.subarray(start, start + sizes[0] + sizes[1]));
  assert.equal(decoder.end().kind, "complete");
  assert.deepEqual(dump(decoder.scene), whole);
  assert.deepEqual([...shownPicks(decoder.scene, 0)], [1, 1]);
});
