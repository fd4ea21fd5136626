/** The loops in WebAssembly against the plain ones: the same integers, or none. */

import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { test } from "node:test";
import { CallerError, StreamError, crc32, decode, decodeFloats, dump, floatView } from "../dist/index.js";
import * as internals from "../dist/internals.js";
import { chance } from "./streams.mjs";

const { FrameDecompressor, Workspace, allowWebAssembly, unpack, unpackSigned, undelta, withEngine } = internals;
const { addSiblings, decodeByEngine, floatsByEngine, refineSlots, siblingsOf } = internals;
const VECTORS = new URL("../../../../conformance/vectors/", import.meta.url);
const hex = (bytes) => Buffer.from(bytes).toString("hex");

/** What `work` gives with and without WebAssembly. */
function bothWays(work) {
  const results = [];
  for (const flag of [true, false]) {
    allowWebAssembly(flag);
    try {
      results.push(work());
    } finally {
      allowWebAssembly(true);
    }
  }
  return results;
}

function vectors() {
  return readdirSync(VECTORS, { recursive: true })
    .filter((path) => path.endsWith(".evogs"))
    .map((path) => ({ path, file: new Uint8Array(readFileSync(new URL(path, VECTORS))) }));
}

const bytesOf = (arrays) => Buffer.concat(arrays.map(({ buffer }) => new Uint8Array(buffer)));

/** The bytes of the dump and of the floats of a file, or its fault. */
function outcome(file) {
  try {
    const scene = decode(file);
    const floats = bytesOf(floatView(scene));
    assert.ok(bytesOf(decodeFloats(file)).equals(floats));
    return Buffer.concat([dump(scene), floats]);
  } catch (error) {
    if (!(error instanceof StreamError || error instanceof CallerError)) throw error;
    assert.throws(() => decodeFloats(file), { code: error.code, offset: error.offset });
    return Buffer.from(`${error.code} ${error.offset}`);
  }
}

test("vectors give the same integers, floats and faults without WebAssembly", () => {
  for (const { path, file } of vectors()) {
    const [compiled, plain] = bothWays(() => outcome(file));
    assert.ok(compiled.equals(plain), path);
  }
});

test("Node has WebAssembly, and whole files are decoded in it", () => {
  const file = new Uint8Array(readFileSync(new URL("../../../../spec/example.evogs", import.meta.url)));
  const { directory, cut } = decode(file);
  for (const byEngine of [decodeByEngine, floatsByEngine]) {
    const [done, refused] = bothWays(() => byEngine(file, directory, cut));
    assert.notEqual(done, null);
    assert.equal(refused, null);
  }
});

/** The frames of a file: where one begins, its blocks begin and it ends, and its size. */
function framesOf(file) {
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  const frames = [];
  for (let at = 0; at + 9 < file.length; at++) {
    if (view.getUint32(at, true) !== 0xfd2fb528) continue;
    const width = 1 << (file[at + 4] >> 6);
    const blocks = at + 5 + width;
    const size =
      width === 1 ? file[at + 5] : width === 2 ? view.getUint16(at + 5, true) + 256 : view.getUint32(at + 5, true);
    let p = blocks;
    for (let isLast = false; !isLast && p + 4 <= file.length; ) {
      const head = view.getUint32(p, true) & 0xffffff;
      isLast = (head & 1) === 1;
      p += 3 + (((head >> 1) & 3) === 1 ? 1 : head >> 3);
    }
    if (p <= file.length && size > 0 && size < 1 << 20) frames.push({ bytes: file.slice(blocks, p), size });
  }
  return frames;
}

/** The content of the blocks of a frame by the plain code; null if they are corrupt. */
function plainContent(decompressor, bytes, size) {
  const out = new Uint8Array(size);
  try {
    decompressor.run(bytes, out, 0, size);
    return hex(out);
  } catch (error) {
    assert.equal(error.name, "ZstdError");
    return null;
  }
}

function compiledContent(bytes, size) {
  return withEngine((engine) => {
    const out = engine.take(size);
    const input = engine.take(bytes.length);
    engine.bytes.set(bytes, input);
    const isGood = engine.kernels.decompress(input, input + bytes.length, out, size);
    return isGood ? hex(engine.bytes.subarray(out, out + size)) : null;
  });
}

test("frames, whole and damaged, have the same content, or are corrupt in both", () => {
  const decompressor = new FrameDecompressor();
  const random = chance(7);
  let good = 0;
  let corrupt = 0;
  const compressed = ({ bytes }) => bytes.length > 8 && ((bytes[0] >> 1) & 3) === 2;
  for (const { path, file } of vectors()) {
    for (const { bytes, size } of framesOf(file).filter(compressed)) {
      for (let damage = 0; damage < 60; damage++) {
        const changed = bytes.slice();
        // Headers of blocks are checked elsewhere (5.10): the damage is in the first block, behind its header.
        const end = 3 + ((bytes[0] | (bytes[1] << 8) | (bytes[2] << 16)) >> 3);
        if (damage > 0) changed[3 + random(end - 3)] ^= 1 << random(8);
        const plain = plainContent(decompressor, changed, size);
        assert.equal(compiledContent(changed, size), plain, path);
        if (plain === null) corrupt++;
        else good++;
      }
    }
  }
  assert.ok(good > 500 && corrupt > 500, `${good} good, ${corrupt} corrupt`);
});

test("planes become the same integers, for all codings and lengths", () => {
  const random = chance(8);
  for (let round = 0; round < 600; round++) {
    const n = 1 + random(70);
    const coding = (1 + random(8)) | (random(3) << 4);
    const low = coding & 15;
    const planes = Uint8Array.from(
      { length: 3 * n },
      (_, i) => random(256) & (i < n && low > 4 ? (1 << low) - 1 : 255),
    );
    if (low < 4 || low === 4) planes.fill(random(256) & 15, Math.floor((n * low) / 8), Math.ceil((n * low) / 8));
    const factor = 1 + random(60);
    const stored = new Int32Array(n);
    const signed = new Int32Array(n);
    unpack(coding, n, planes, 0, stored);
    unpackSigned(coding, n, planes, 0, factor, signed);
    withEngine((engine) => {
      const from = engine.take(planes.length);
      const out = engine.takeIntegers(n);
      const guard = engine.mark();
      engine.bytes.set(planes, from);
      engine.bytes.fill(170, guard, guard + 8);
      engine.kernels.unpack(coding, n, from, out);
      assert.deepEqual(engine.at(out, n), stored, `coding ${coding}`);
      const furthest = engine.kernels.unpackSigned(coding, n, from, factor, out);
      assert.deepEqual(engine.at(out, n), signed, `coding ${coding}`);
      for (const value of signed) assert.ok(Math.abs(value) <= furthest * factor);
      assert.ok(engine.bytes.subarray(guard, guard + 8).every((byte) => byte === 170));
      const sums = undelta(signed, n);
      const sum = engine.kernels.undelta(out, n) >>> 0;
      assert.ok(sums || sum > 2 ** 28);
      assert.deepEqual(engine.at(out, n), signed);
      assert.equal(engine.kernels.crc32(from, planes.length) >>> 0, crc32(planes));
    });
  }
});

/** Increasing numbers below `n` with gaps: some of them, in runs of up to `longest`. */
function someSlots(random, n, longest) {
  const slots = [];
  for (let slot = random(longest); slot < n; slot += 1 + random(longest)) {
    for (let left = 1 + random(longest); left > 0 && slot < n; left--) slots.push(slot++);
  }
  return Int32Array.from(slots);
}

test("steps have the same children as the plain loops, for runs of all lengths", () => {
  const random = chance(9);
  for (let round = 0; round < 400; round++) {
    const n = 2 + random(120);
    const slots = someSlots(random, n, 1 + random(20));
    const areAllSplits = random(2) === 0;
    const splits = Int32Array.from(slots.keys()).filter(() => areAllSplits || random(4) > 0);
    const parents = splits.map((place) => slots[place]);
    const integers = (count, most) => Int32Array.from({ length: count }, () => random(2 * most + 1) - most);
    const x = integers(n + splits.length, 1000);
    const delta = integers(slots.length, 300);
    const table = { shift: random(4), entries: Int16Array.from({ length: 3 }, () => 1 + random(9)) };
    const indices = random(2) ? Uint8Array.from(splits, () => random(3)) : null;
    const least = -random(2500);
    const most = 800 + random(2500);
    withEngine((engine) => {
      const { kernels } = engine;
      // A number behind the end shows whether a loop writes too far.
      const at = engine.put(Int32Array.of(...x, 77, 77, 77, 77));
      const runs = engine.takeIntegers(3 * slots.length);
      const splitRuns = engine.takeIntegers(3 * slots.length);
      const [from, places] = [engine.put(delta), areAllSplits ? 0 : engine.put(splits)];
      const singles = engine.put(slots);
      const nRuns = kernels.runsOf(0, singles, slots.length, runs);
      const nSplitRuns = kernels.runsOf(places, engine.put(parents), splits.length, splitRuns);
      const alpha = engine.takeIntegers(splits.length);
      const chosen = indices ? engine.put(Int32Array.from(indices)) : 0;
      kernels.valuesOf(engine.put(table.entries), chosen, splits.length, alpha);
      const { shift } = table;
      const areSecondsGood = kernels.writeSeconds(
        at,
        at + 4 * n,
        splitRuns,
        nSplitRuns,
        from,
        alpha,
        shift,
        least,
        most,
      );
      const areChangedGood =
        random(3) === 0
          ? kernels.addDeltaEach(at, singles, slots.length, from, least, most)
          : kernels.addDelta(at, runs, nRuns, from, least, most);
      const column = { x, least, most };
      const step = { slots, n: slots.length, splits, parents, nSplits: splits.length, table, indices, first: n };
      assert.equal(Boolean(areSecondsGood && areChangedGood), refineSlots(column, step, delta));
      assert.deepEqual(engine.at(at, x.length + 4), Int32Array.of(...x, 77, 77, 77, 77));
    });
  }
});

test("sibling differences have the same sums as in the plain loops, for families of all shapes", () => {
  const random = chance(10);
  const workspace = new Workspace();
  for (let round = 0; round < 400; round++) {
    // Generations of slots, most of them born in runs.
    const bornFrom = Int32Array.from({ length: 2 + random(20) }, () => -1);
    const all = [...bornFrom];
    for (let born = 0; born < 1 + random(5); born++) {
      for (const parent of someSlots(random, all.length, 1 + random(12))) all.push(parent);
    }
    const slots = someSlots(random, all.length, 1 + random(60));
    const values = Int32Array.from(slots, () => random(2001) - 1000);
    const isSingle = random(3) === 0;
    withEngine((engine) => {
      const { kernels } = engine;
      const at = engine.put(Int32Array.of(...values, 77, 77, 77, 77));
      const runs = engine.takeIntegers(3 * slots.length + 1);
      const [places, growth] = [engine.takeIntegers(all.length), engine.takeIntegers(slots.length)];
      engine.at(places, all.length).fill(random(40));
      const nRuns = kernels.siblingsOf(
        engine.put(slots),
        slots.length,
        engine.put(Int32Array.from(all)),
        places,
        growth,
        isSingle ? 1 : slots.length,
        runs,
      );
      const most = values.reduce((a, b) => Math.max(a, Math.abs(b)), 0) * engine.at(runs + 12 * nRuns, 1)[0];
      (isSingle ? kernels.addSiblingsEach : kernels.addSiblings)(at, runs, nRuns);
      assert.ok(
        addSiblings(values, slots.length, siblingsOf(slots, slots.length, Int32Array.from(all), workspace)),
      );
      assert.deepEqual(engine.at(at, slots.length + 4), Int32Array.of(...values, 77, 77, 77, 77));
      assert.ok(values.every((value) => Math.abs(value) <= most));
    });
  }
});
