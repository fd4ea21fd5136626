/** What picks require of a palette (spec 12.2): the packets of levels up to their label that stand before them. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Decoder, decode, decodeFloats, dump, floatView, sha256, shownPicks } from "../dist/index.js";
import { allowWebAssembly, decodeByEngine, floatsByEngine } from "../dist/internals.js";
import { CORE, PALETTE, PICKS, chance, core, packet, stream } from "./streams.mjs";

/** Packets of the palette, whose entries are those numbers; of core, with adds; and of picks. */
const entries = (level, ...numbers) => {
  const bytes = packet(9, { 0: [0x08, numbers.map((x) => 2 * x)] });
  return { component: PALETTE, level, adds: numbers.length, bytes };
};
const adds = (tile, level, n) => ({ tile, level, adds: n, bytes: core({}) });
const picks = (tile, ...numbers) => ({ tile, component: PICKS, bytes: packet(1, { 0: [0x08, numbers] }) });

const of = (nLevels, rows, nTiles = 2) => stream({ nTiles, nLevels, shDegree: 1, hasPalette: true, rows });

/** The example of 12.2. */
const ROWS = [
  entries(0, 10, 20),
  adds(0, 1, 2),
  picks(0, 2, 1),
  entries(1, 30, 40, 50),
  adds(1, 0, 1),
  picks(1, 2),
  adds(0, 1, 1),
  picks(0, 5),
];
const FILE = of(2, ROWS);

/** The example with other picks in a row. */
const withPicks = (row, ...numbers) => of(2, ROWS.with(row, picks(ROWS[row].tile, ...numbers)));

/** Gives a decoder packets one by one, after all that is before them. After each, `came` is told what is applied. */
function arrive(file, order, came = () => {}, options = {}) {
  const decoder = new Decoder(options);
  decoder.feed(file.subarray(0, 64));
  decoder.feed(file.subarray(64, 64 + decoder.header.chunksSize));
  const { offset, size } = decoder.directory.packets;
  for (const i of order) {
    decoder.put(offset[i], file.subarray(offset[i], offset[i] + size[i]));
    came(decoder.progress.applied, i);
  }
  return decoder;
}

const inFileOrder = (rows) => Array.from(rows, (_, i) => i);

test("a level of entries in several packets, with picks between them", () => {
  const { directory, cut } = decode(FILE);
  const { packets } = directory;
  assert.deepEqual([...packets.palette], [-1, -1, 0, -1, -1, 0, -1, 3]);
  assert.deepEqual(
    [2, 5, 7].map((i) => packets.entriesFor(i)),
    [2, 2, 5],
  );
  const whole = decodeByEngine(FILE, directory, cut);
  assert.deepEqual([...shownPicks(whole, 0)], [2, 1, 5]);
  assert.deepEqual([...shownPicks(whole, 1)], [2]);
  const floats = floatsByEngine(FILE, directory, cut);
  assert.deepEqual([...floats[14]], [20, 10, 50, 20]);
  allowWebAssembly(false);
  try {
    const plain = decode(FILE);
    assert.deepEqual(dump(plain), dump(whole));
    assert.deepEqual(floatView(plain), floats);
  } finally {
    allowWebAssembly(true);
  }
});

test("levels of it have the entries up to their label, as a whole and progressively", () => {
  for (const level of [0, 1]) {
    const whole = decode(FILE, { level });
    const decoder = arrive(FILE, inFileOrder(ROWS), undefined, { level });
    assert.equal(decoder.end().kind, "complete");
    assert.deepEqual(dump(decoder.scene), dump(whole));
    assert.equal(whole.palette.count, level ? 5 : 2);
    assert.deepEqual(
      [0, 1].map((t) => [...shownPicks(whole, t)]),
      level ? [[2, 1, 5], [2]] : [[], [2]],
    );
  }
});

test("no packet waits in the order of the file", () => {
  let n = 0;
  const decoder = arrive(FILE, inFileOrder(ROWS), (applied) => assert.equal(applied, ++n));
  assert.equal(decoder.end().kind, "complete");
  assert.deepEqual(dump(decoder.scene), dump(decode(FILE)));
});

test("only those picks wait for a packet of the palette that stand behind it", () => {
  const without = (row) => inFileOrder(ROWS).filter((i) => i !== row);
  let decoder = arrive(FILE, without(3));
  assert.equal(decoder.progress.applied, ROWS.length - 2);
  assert.deepEqual([...shownPicks(decoder.scene, 0)], [2, 1, 0]);
  assert.deepEqual([...shownPicks(decoder.scene, 1)], [2]);
  decoder = arrive(FILE, without(0));
  assert.equal(decoder.progress.applied, 3);
  const { offset } = decoder.directory.packets;
  decoder.put(offset[0], FILE.subarray(offset[0], offset[1]));
  assert.equal(decoder.end().kind, "complete");
  assert.deepEqual(dump(decoder.scene), dump(decode(FILE)));
});

test("a pick beyond the entries that stand before it is E_INDEX, whatever has come (R-7.2-4)", () => {
  for (const [row, ...numbers] of [
    [2, 3, 1],
    [2, 1, 5],
    [5, 3],
    [7, 6],
  ]) {
    const file = withPicks(row, ...numbers);
    const inOrder = inFileOrder(ROWS);
    const palettesFirst = [...inOrder].sort(
      (a, b) => (ROWS[b].component === PALETTE) - (ROWS[a].component === PALETTE),
    );
    for (const order of [inOrder, palettesFirst, inOrder.toReversed()]) {
      const decoder = arrive(file, order);
      const { offset } = decoder.directory.packets;
      const fault = { code: "E_INDEX", offset: offset[row] };
      assert.throws(() => decode(file), fault);
      assert.throws(() => decodeFloats(file), fault);
      assert.equal(decoder.fault.code, fault.code);
      assert.equal(decoder.end().fault.offset, fault.offset);
      assert.equal(decoder.scene.palette.count, 5);
    }
  }
  // Nothing of the palette is before them, or it is all of levels above their label.
  for (const rows of [
    [adds(0, 0, 1), picks(0, 1), entries(0, 10)],
    [entries(1, 10), entries(2, 10), adds(0, 0, 1), picks(0, 1)],
  ]) {
    assert.throws(() => decode(of(3, rows)), { code: "E_INDEX" });
    assert.throws(() => decodeFloats(of(3, rows)), { code: "E_INDEX" });
  }
});

test("a faulty packet of the palette stops the picks behind it alone", () => {
  const bad = FILE.slice();
  const { offset } = decode(FILE).directory.packets;
  bad[offset[3] + 1] ^= 1;
  const decoder = arrive(bad, inFileOrder(ROWS));
  assert.equal(decoder.fault.code, "E_CRC");
  assert.equal(decoder.progress.applied, ROWS.length - 2);
});

test("rows of the palette say tile 0 (R-5.6-10)", () => {
  const rows = ROWS.with(3, { ...ROWS[3], tile: 1 });
  assert.throws(() => decode(of(2, rows)), { code: "E_CHAIN" });
});

/** Rows by chance: tiles with steps of rising labels, picks of what may be picked, and entries anywhere. */
function rowsByChance(random, nTiles, nLevels) {
  const rows = [];
  const labels = new Array(nTiles).fill(0);
  const unpicked = Array.from({ length: nTiles }, () => []);
  let level = 0;
  const counts = [];
  for (let k = 0; k < 40; k++) {
    const tile = random(nTiles);
    const kind = random(5);
    if (kind === 0) {
      level = Math.min(nLevels - 1, level + (random(3) === 0 ? random(3) : 0));
      const n = random(4);
      counts.push([level, n]);
      rows.push(n === 0 ? { component: PALETTE, level } : entries(level, ...Array.from({ length: n }, () => k)));
    } else if (kind < 3 || unpicked[tile].length === 0) {
      labels[tile] = Math.min(nLevels - 1, labels[tile] + (random(3) === 0 ? random(3) : 0));
      unpicked[tile].push(labels[tile]);
      rows.push(adds(tile, labels[tile], 1));
    } else {
      const label = unpicked[tile].shift();
      const most = counts.reduce((sum, [of, n]) => sum + (of <= label ? n : 0), 0);
      rows.push(random(4) === 0 ? { tile, component: PICKS } : picks(tile, random(most + 1)));
    }
  }
  return rows;
}

/** The packets that each one requires, by 3.5. */
function requiredBy({ tile, component, step, label, core: coreOf, length }) {
  return Array.from({ length }, (_, p) =>
    Array.from({ length }, (_, q) => q).filter((q) => {
      if (component[q] === PALETTE && component[p] === PICKS) return q < p && label[q] <= label[p];
      if (component[q] === component[p] && tile[q] === tile[p]) return step[q] === step[p] - 1;
      return component[p] === PICKS && coreOf[p] === q;
    }),
  );
}

test("what is applied is the largest cut of what has come, for palettes and arrivals by chance (R-6.4-1)", () => {
  const random = chance(12);
  for (let round = 0; round < 150; round++) {
    const nLevels = 1 + random(4);
    const rows = rowsByChance(random, 3, nLevels);
    const file = of(nLevels, rows, 3);
    const scene = decode(file);
    const { packets } = scene.directory;
    assert.notEqual(decodeByEngine(file, scene.directory, scene.cut), null);
    const requires = requiredBy(packets);
    const has = new Set(inFileOrder(rows).filter((i) => packets.size[i] === 0));
    const order = inFileOrder(rows).filter((i) => packets.size[i] > 0);
    if (round % 3 > 0) order.sort(() => random(3) - 1);
    let isInOrder = round % 3 === 0;
    const decoder = arrive(file, order, (applied, i) => {
      has.add(i);
      const closed = new Set();
      for (let p = 0; p < packets.length; p++) {
        if (has.has(p) && requires[p].every((q) => closed.has(q))) closed.add(p);
      }
      assert.equal(applied, closed.size);
      // In the order of the file nothing waits.
      isInOrder &&= [...has].every((p) => packets.size[p] === 0 || closed.has(p));
    });
    assert.equal(isInOrder, round % 3 === 0);
    assert.equal(decoder.end().kind, "complete");
    assert.deepEqual(sha256(dump(decoder.scene)), sha256(dump(scene)));
  }
});

test("many packets of a palette, each before its picks, in any order", () => {
  const rows = [];
  const n = 8000;
  for (let k = 0; k < n; k++) rows.push(entries(0, k & 63), adds(k, 0, 1), picks(k, Math.min(k + 1, 255)));
  const file = of(1, rows, n);
  const ofPalette = inFileOrder(rows).filter((i) => rows[i].component === PALETTE);
  const others = inFileOrder(rows).filter((i) => rows[i].component !== PALETTE);
  for (const order of [[...others, ...ofPalette], inFileOrder(rows).reverse()]) {
    const decoder = arrive(file, order);
    assert.equal(decoder.end().kind, "complete");
    assert.equal(decoder.scene.palette.count, n);
  }
  assert.equal(decode(file).tile(n - 1).steps[CORE], 1);
});
