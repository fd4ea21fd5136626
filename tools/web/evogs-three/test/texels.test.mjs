import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { Decoder, channelsOf, decode, slotFloats } from "evogs";
import { chance, core, packet, stream } from "../../evogs/test/streams.mjs";
import { Halves, half, lnScale, packRotation } from "../dist/pack.js";
import { SOURCES, TEXELS, TexelWriter, layoutOf } from "../dist/texels.js";

/** The number that 16 bits stand for, by IEEE 754. */
function ofHalf(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const mantissa = bits & 1023;
  return sign * (exponent === 0 ? mantissa * 2 ** -24 : (1 + mantissa / 1024) * 2 ** (exponent - 15));
}

test("every binary16 number is packed as itself, and numbers between as the nearer one", () => {
  for (let bits = 0; bits < 0x7c00; bits++) {
    assert.equal(half(ofHalf(bits)), bits);
    assert.equal(half(-ofHalf(bits)), bits === 0 ? half(-0) : bits | 0x8000);
    if (bits === 0x7bff) continue;
    const [low, high] = [ofHalf(bits), ofHalf(bits + 1)];
    assert.equal(half(low + 0.4 * (high - low)), bits);
    assert.equal(half(low + 0.6 * (high - low)), bits + 1);
    assert.equal(half((low + high) / 2), bits + (bits & 1));
  }
  assert.equal(ofHalf(half(1e9)), 65504);
});

test("integers are packed as the numbers that they stand for, in the table and beyond it", () => {
  const halves = new Halves(2 ** -9);
  for (const n of [0, 1, -1, 511, 32767, -32768, 32768, -32769, 1 << 24, -(1 << 30), 2 ** 31 - 1]) {
    assert.equal(halves.of(n), half(n / 512), n);
  }
});

/** As the shader reads it. */
function rotationOf(low, high) {
  const parts = [low & 0x7fff, (low >>> 15) & 0x7fff, high & 0x7fff].map(
    (n) => ((n - 16383.5) * Math.SQRT2) / 32767,
  );
  const rest = Math.sqrt(Math.max(0, 1 - parts.reduce((sum, x) => sum + x * x, 0)));
  parts.splice(low >>> 30, 0, rest);
  return parts;
}

test("rotations are packed to within 1e-4, whatever their sign and length", () => {
  const random = chance(1);
  const out = new Uint32Array(2);
  for (let k = 0; k < 20000; k++) {
    const q = Array.from({ length: 4 }, () => random(2001) - 1000);
    if (q.every((x) => x === 0)) continue;
    packRotation(...q, out, 0);
    assert.ok(out[1] < 0x8000);
    const found = rotationOf(out[0], out[1]);
    const length = Math.hypot(...q);
    const same = Math.abs(q.reduce((sum, x, i) => sum + (x * found[i]) / length, 0));
    assert.ok(same > 1 - 1e-8, `${q}: ${found}`);
  }
  packRotation(0, 0, 0, 0, out, 0);
  assert.ok(rotationOf(...out)[0] > 0.9999);
});

test("scales are packed to within 0.03 %", () => {
  for (let ln = -20; ln < 11.99; ln += 0.0137)
    assert.ok(Math.abs(lnScale(ln) / 2048 - 20 - ln) <= 1 / 4096 + 1e-9);
  assert.deepEqual([lnScale(-99), lnScale(99)], [0, 65535]);
});

const ADDS = 21;

/** Three tiles whose slots come in turns, with SH of degree 1. */
function scene(n = 700) {
  const random = chance(5);
  const planes = (first, count) =>
    Object.fromEntries(
      Array.from({ length: count }, (_, k) => [first + k, [0x08, Array.from({ length: n }, () => random(20))]]),
    );
  const rows = [];
  for (let level = 0; level < 3; level++) {
    for (let tile = 0; tile < 3; tile++) rows.push({ tile, level, adds: n, bytes: core(planes(ADDS, 14)) });
  }
  for (let k = 0; k < 9; k++) rows.push({ tile: k % 3, component: 1, bytes: packet(18, planes(9, 9)) });
  return stream({ nTiles: 3, nLevels: 3, shDegree: 1, rows });
}

/** Textures as a GPU would have them. */
class Textures {
  constructor({ width, rows, shDegree }) {
    this.width = width;
    this.words = TEXELS.slice(0, shDegree + 1).map((n) => new Uint32Array(4 * n * width * rows));
  }

  write(updates) {
    for (const { texture, column, row, columns, rows, data } of updates) {
      if (texture === SOURCES) continue;
      const n = 4 * TEXELS[texture];
      assert.equal(data.length, n * columns * rows);
      for (let r = 0; r < rows; r++) {
        const part = data.subarray(n * columns * r, n * columns * (r + 1));
        this.words[texture].set(part, n * (this.width * (row + r) + column));
      }
    }
  }
}

test("updates of a stream give the same texels as the scene as a whole", () => {
  const file = scene();
  const decoder = new Decoder();
  let writer = null;
  let textures = null;
  let sent = 0;
  for (let at = 0; at < file.length; at += 3000) {
    decoder.put(at, file.subarray(at, at + 3000));
    if (decoder.scene === null) continue;
    writer ??= new TexelWriter(decoder.scene);
    textures ??= new Textures(writer.layout);
    const updates = writer.write(decoder.takeChanges(64));
    sent += updates.reduce((sum, { data }) => sum + data.length, 0);
    textures.write(updates);
  }
  const { layout } = writer;
  assert.equal(layout.rows, writer.usedRows);
  const again = new Textures(layout);
  again.write(writer.writeAll());
  assert.deepEqual(textures.words, again.words);
  const total = again.words.reduce((sum, words) => sum + words.length, 0);
  assert.ok(sent < 2 * total, `${sent} words for ${total}`);
});

test("a texel has the numbers of its slot", () => {
  const whole = decode(scene());
  const writer = new TexelWriter(whole);
  const [first] = writer.writeAll();
  assert.deepEqual([first.texture, first.column, first.row], [0, 0, 0]);
  const floats = new Float32Array(first.data.buffer);
  for (let axis = 0; axis < 3; axis++) assert.equal(floats[8 * 5 + axis], slotFloats(whole, 0, axis, 5, 6)[0]);
  const opacity = 1 / (1 + Math.exp(-slotFloats(whole, 0, 10, 5, 6)[0]));
  assert.equal(first.data[8 * 5 + 3] & 0xffff, half(opacity));
});

/** What the texels of a band must be: two coefficients in a word, as `slotFloats` has them. */
function expectedBand(scene, tile, band, slot) {
  const { first, count } = channelsOf(band, scene.directory.header.shDegree);
  const words = new Uint32Array(4 * TEXELS[band]);
  for (let k = 0; k < count; k++) {
    words[k >> 1] |= half(slotFloats(scene, tile, first + k, slot, slot + 1)[0]) << (16 * (k & 1));
  }
  return words;
}

const PALETTES = [
  new URL("../../../../spec/example-2.evogs", import.meta.url),
  new URL("../../../../conformance/vectors/palette/palette-arrival-palette-last.evogs", import.meta.url),
];

test("texels of picks are those of the entries that are shown, whatever has come", () => {
  for (const path of PALETTES) {
    const file = new Uint8Array(readFileSync(path));
    const decoder = new Decoder();
    let writer = null;
    let textures = null;
    let compared = 0;
    for (let at = 0; at < file.length; at++) {
      decoder.feed(file.subarray(at, at + 1));
      const { scene } = decoder;
      if (scene === null) continue;
      writer ??= new TexelWriter(scene);
      textures ??= new Textures(writer.layout);
      const changes = decoder.takeChanges();
      textures.write(writer.write(changes));
      if (changes.length === 0) continue;
      const { nTiles, shDegree } = scene.directory.header;
      const again = new Textures(writer.layout);
      again.write(writer.writeAll());
      assert.deepEqual(textures.words, again.words);
      for (let tile = 0; tile < nTiles; tile++) {
        for (let slot = 0; slot < scene.tile(tile).nSlots; slot++) {
          for (let band = 1; band <= shDegree; band++) {
            const [update] = writer.write([{ tile, component: band, ranges: [{ start: slot, count: 1 }] }]);
            assert.deepEqual(update.data, expectedBand(scene, tile, band, slot), `${at}: ${tile} ${slot} ${band}`);
            compared++;
          }
        }
      }
    }
    assert.ok(compared > 0 && decoder.scene.palette.count > 0);
  }
});

test("second children grow from the place of the ancestor that was there before", () => {
  const file = new Uint8Array(readFileSync(new URL("../../../../spec/example.evogs", import.meta.url)));
  for (const step of [1, 40, file.length]) {
    const decoder = new Decoder();
    let writer = null;
    let had = [];
    let born = 0;
    for (let at = 0; at < file.length; at += step) {
      decoder.feed(file.subarray(at, at + step));
      const { scene } = decoder;
      if (scene === null) continue;
      writer ??= new TexelWriter(scene);
      const { width } = writer.layout;
      const told = new Map();
      for (const { texture, column, row, columns, data } of writer.write(decoder.takeChanges())) {
        if (texture !== SOURCES) continue;
        data.forEach((word, i) =>
          told.set(width * (row + Math.floor(i / columns)) + column + (i % columns), word),
        );
      }
      // The example has one tile, whose slots stand one after the other.
      const { nSlots, bornFrom } = scene.tile(0);
      for (let u = had.length; u < nSlots && had.length > 0; u++) {
        let ancestor = bornFrom[u];
        while (ancestor >= had.length) ancestor = bornFrom[ancestor];
        assert.equal(told.get(u), 1 + ancestor, `slot ${u}`);
        if (ancestor >= 0) born++;
      }
      assert.ok([...told.keys()].every((u) => u >= had.length && u < nSlots));
      had = Array.from({ length: nSlots });
    }
    assert.equal(born > 0, step < file.length, `${step}`);
  }
});

test("dropped splats are transparent", () => {
  const file = new Uint8Array(readFileSync(new URL("../../../../spec/example.evogs", import.meta.url)));
  const whole = decode(file);
  const live = whole.tile(0).liveSlots();
  assert.ok(live.includes(0));
  const [core] = new TexelWriter(whole).writeAll();
  live.forEach((isLive, u) => assert.equal((core.data[8 * u + 3] & 0xffff) > 0, isLive === 1));
});

test("layouts fit in the textures of a GPU, or are refused", () => {
  const { directory } = decode(scene(5000));
  for (const most of [1024, 2048, 4096, 16384]) {
    const { width, rows } = layoutOf(directory, most);
    assert.ok(rows <= most && width * TEXELS[1] <= most);
    assert.ok(width * rows >= 45000);
  }
  assert.throws(() => layoutOf(directory, 150), RangeError);
});
