import assert from "node:assert/strict";
import { test } from "node:test";
import { Decoder, decode, dump } from "evogs";
import { CORE, PALETTE, PICKS, chance, core, packet, stream } from "../../evogs/test/streams.mjs";
import { FetchError, Intervals, SceneFetch, fileOrder, viewOrder } from "../dist/index.js";
import { serve } from "./server.mjs";

const ADDS = 21;

/** A scene of 4 tiles, 3 levels and SH of degree 1: 12 packets of core, then 12 of SH, about 400 kB. */
function scene(n = 1500) {
  const random = chance(7);
  const planes = (first, count) =>
    Object.fromEntries(
      Array.from({ length: count }, (_, k) => [first + k, [0x08, Array.from({ length: n }, () => random(250))]]),
    );
  const rows = [];
  for (let level = 0; level < 3; level++) {
    for (let tile = 0; tile < 4; tile++) rows.push({ tile, level, adds: n, bytes: core(planes(ADDS, 14)) });
  }
  for (let k = 0; k < 12; k++) rows.push({ tile: k % 4, component: 1, bytes: packet(18, planes(9, 9)) });
  return stream({ nTiles: 4, nLevels: 3, shDegree: 1, rows });
}

const FILE = scene();
const QUICK = { backOff: 5 };

async function withServer(bytes, behaviour, use) {
  const server = await serve(bytes, behaviour);
  try {
    return await use(server);
  } finally {
    await server.close();
  }
}

function assertWhole(decoder, file = FILE) {
  assert.equal(decoder.end().kind, "complete");
  assert.deepEqual(dump(decoder.scene), dump(decode(file)));
}

test("a scene comes in few requests, the directory first, no byte twice", () =>
  withServer(FILE, {}, async ({ url, log }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, QUICK);
    await fetcher.run();
    assert.equal(fetcher.received, FILE.length);
    assert.equal(log.sent, FILE.length);
    assert.equal(fetcher.repeated, 0);
    assert.equal(log.requests[0], "bytes=0-65535");
    assert.ok(log.requests.length <= 8, log.requests.join());
    assertWhole(decoder);
  }));

test("a directory that is larger than 64 kB takes two requests", () => {
  const rows = Array.from({ length: 3000 }, () => ({ adds: 1, bytes: core({ [ADDS]: [0x08, [1]] }) }));
  const file = stream({ rows });
  return withServer(file, {}, async ({ url, log }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, { ...QUICK, order: () => [] });
    await fetcher.run();
    assert.ok(decoder.directory);
    assert.equal(log.requests.length, 2);
    assert.equal(log.sent, decoder.directory.packets.offset[0]);
  });
});

test("without ranges, the file is read once from its beginning", () =>
  withServer(FILE, { ranges: false }, async ({ url, log }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, QUICK);
    await fetcher.run();
    assert.ok(fetcher.isSequential);
    assert.equal(log.requests.length, 1);
    assert.equal(log.sent, FILE.length);
    assertWhole(decoder);
  }));

for (const ranges of [true, false]) {
  test(`a dropped connection is taken up again, ${ranges ? "with" : "without"} ranges`, () =>
    withServer(FILE, { ranges, dropAfter: 200000, tag: '"a"' }, async ({ url, log }) => {
      const decoder = new Decoder();
      const states = [];
      const fetcher = new SceneFetch(url, decoder, { ...QUICK, onState: () => states.push(fetcher.state) });
      await fetcher.run();
      assert.ok(states.includes("waiting"));
      assertWhole(decoder);
      if (ranges) assert.equal(fetcher.repeated, 0);
      assert.ok(log.requests.length >= 2);
    }));
}

test("a server that comes back late is waited for, and one that stays away is given up", () =>
  withServer(FILE, { flaky: 3 }, async ({ url, state }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, { ...QUICK, retries: 4, order: fileOrder({ bytes: 200000 }) });
    await fetcher.run();
    state.flaky = 99;
    fetcher.want(fileOrder());
    const before = fetcher.received;
    await assert.rejects(fetcher.run(), { name: "FetchError", kind: "lost" });
    assert.equal(fetcher.received, before);
    state.flaky = 0;
    await fetcher.run();
    assertWhole(decoder);
    assert.equal(fetcher.repeated, 0);
  }));

test("after a failure the state is waiting until bytes come, in the next run too", () =>
  withServer(FILE, { flaky: 3 }, async ({ url, state }) => {
    const states = [];
    const options = { ...QUICK, retries: 4, order: fileOrder({ bytes: 200000 }) };
    const fetcher = new SceneFetch(url, new Decoder(), { ...options, onState: () => states.push(fetcher.state) });
    await fetcher.run();
    assert.deepEqual(states.splice(0), ["loading", "waiting", "loading", "stopped"]);
    assert.equal(fetcher.failure, null);
    fetcher.want(fileOrder());
    state.flaky = 99;
    await assert.rejects(fetcher.run(), { kind: "lost" });
    assert.deepEqual(states.splice(0), ["loading", "waiting", "stopped"]);
    assert.ok(fetcher.failure);
    state.flaky = 1;
    await fetcher.run();
    assert.deepEqual(states, ["waiting", "loading", "stopped"]);
    assert.equal(fetcher.failure, null);
  }));

test("an answer that stalls is given up and asked for again", () =>
  withServer(FILE, { endless: true }, async ({ url, state, log }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, { ...QUICK, stallSeconds: 0.05 });
    setTimeout(() => {
      state.endless = false;
    }, 120);
    await fetcher.run();
    assert.ok(log.requests.length > 2);
    assertWhole(decoder);
  }));

test("404 fails at once", () =>
  withServer(FILE, { status: 404 }, async ({ url, log }) => {
    await assert.rejects(new SceneFetch(url, new Decoder(), QUICK).run(), { kind: "status", status: 404 });
    assert.equal(log.requests.length, 1);
  }));

test("503 is tried again", () =>
  withServer(FILE, { status: 503 }, async ({ url, log }) => {
    const fetcher = new SceneFetch(url, new Decoder(), { ...QUICK, retries: 2 });
    await assert.rejects(fetcher.run(), { kind: "lost", status: 503 });
    assert.equal(log.requests.length, 3);
  }));

for (const ranges of [true, false]) {
  test(`100 MB of zeros are refused after the first bytes, ${ranges ? "with" : "without"} ranges`, () =>
    withServer(new Uint8Array(100e6), { ranges }, async ({ url, log }) => {
      const fetcher = new SceneFetch(url, new Decoder(), QUICK);
      await assert.rejects(fetcher.run(), (error) => {
        assert.ok(error instanceof FetchError);
        assert.equal(error.kind, "bad");
        assert.equal(error.cause.code, "E_SIGNATURE");
        return true;
      });
      await new Promise((resolve) => setTimeout(resolve, 100));
      assert.equal(log.requests.length, 1);
      assert.ok(log.sent < 20e6, `${log.sent}`);
    }));

  test(`a file that is cut short shows what it has and says so, ${ranges ? "with" : "without"} ranges`, () =>
    withServer(FILE.subarray(0, 150000), { ranges }, async ({ url }) => {
      const decoder = new Decoder();
      const fetcher = new SceneFetch(url, decoder, QUICK);
      await assert.rejects(fetcher.run(), { kind: "short" });
      assert.equal(fetcher.received, 150000);
      assert.ok(decoder.progress.applied > 3);
    }));
}

test("an empty file, and one that ends in its directory", async () => {
  for (const size of [0, 30, 200]) {
    await withServer(FILE.subarray(0, size), {}, async ({ url }) => {
      await assert.rejects(new SceneFetch(url, new Decoder(), QUICK).run(), { kind: "short" });
    });
  }
});

test("another file under the same name is refused", () =>
  withServer(FILE, { tag: '"a"' }, async ({ url, state }) => {
    const fetcher = new SceneFetch(url, new Decoder(), { ...QUICK, order: fileOrder({ bytes: 100000 }) });
    await fetcher.run();
    state.tag = '"b"';
    fetcher.want(fileOrder());
    await assert.rejects(fetcher.run(), { kind: "changed" });
  }));

test("a corrupted packet is reported, and all others come", () => {
  const bad = FILE.slice();
  const { packets } = decode(FILE).directory;
  bad[packets.offset[5] + 100] ^= 1;
  return withServer(bad, {}, async ({ url }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, QUICK);
    await fetcher.run();
    assert.equal(fetcher.received, FILE.length);
    assert.equal(decoder.fault.code, "E_CRC");
    assert.equal(decoder.fault.offset, packets.offset[5]);
    // Packet 5 and what needs it: core of tile 1 at level 2, and SH of both steps.
    assert.equal(decoder.progress.applied, packets.length - 4);
  });
});

test("budgets of bytes, splats, levels and SH are kept, and raised later", () =>
  withServer(FILE, {}, async ({ url, log }) => {
    const { packets } = decode(FILE).directory;
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, { ...QUICK, order: fileOrder({ splats: 6000, shDegree: 0 }) });
    await fetcher.run();
    assert.equal(decoder.scene.splatCount(), 6000);
    assert.ok(fetcher.received <= packets.offset[4]);
    fetcher.want(fileOrder({ level: 1, shDegree: 0 }));
    await fetcher.run();
    assert.equal(decoder.scene.splatCount(), 12000);
    fetcher.want(fileOrder({ bytes: 300000 }));
    await fetcher.run();
    assert.ok(fetcher.received <= 300000);
    fetcher.want(fileOrder());
    await fetcher.run();
    assert.equal(log.sent, FILE.length);
    assertWhole(decoder);
  }));

test("an order by view is that of the file with near tiles ahead, and nothing before what it needs", () => {
  const { directory } = decode(FILE);
  const { packets } = directory;
  const all = Array.from({ length: packets.length }, (_, i) => i);
  for (let t = 0; t < 4; t++) {
    directory.tiles.origin.fill(0, 3 * t, 3 * t + 3);
    directory.tiles.boxMin.fill(0, 3 * t, 3 * t + 3);
    directory.tiles.boxMax.fill(100, 3 * t, 3 * t + 3);
  }
  // All look the same.
  assert.deepEqual([...viewOrder({ eye: [50, 50, 50], planes: [] })(directory)], all);
  // Tile 2 is moved away from the others, which are out of sight.
  for (const t of [0, 1, 3]) directory.tiles.origin[3 * t] = 5000;
  const order = [...viewOrder({ eye: [50, 50, 50], planes: [[-1, 0, 0, 200]] })(directory)];
  assert.deepEqual(
    [...order].sort((a, b) => a - b),
    all,
  );
  const place = new Map(order.map((i, k) => [i, k]));
  let ahead = 0;
  for (const i of order) {
    assert.ok(packets.next[i] < 0 || place.get(packets.next[i]) > place.get(i));
    assert.ok(place.get(packets.core[i]) <= place.get(i));
    if (packets.tile[i] !== 2) continue;
    ahead += i - place.get(i);
    // Before all that the file has behind it, and not before what it has three times as early.
    for (const j of all.slice(i + 1)) assert.ok(place.get(j) > place.get(i));
    for (const j of all) if (packets.offset[j] < 0.3 * packets.offset[i]) assert.ok(place.get(j) < place.get(i));
  }
  assert.ok(ahead > packets.length, `${ahead} places`);
});

/** Two tiles whose picks need more and more of a palette. Packets of entries are as large as `n` says. */
function pickedScene(n) {
  const entries = (level) => ({
    component: PALETTE,
    level,
    adds: n,
    bytes: packet(9, { 0: [0x08, new Array(n).fill(2)] }),
  });
  const shown = (tile, level, pick) => [
    { tile, level, adds: 1, bytes: core({ [ADDS]: [0x08, [1]] }) },
    { tile, component: PICKS, bytes: packet(1, { 0: [0x08, [pick]] }) },
  ];
  const rows = [
    entries(0),
    shown(0, 1, 1),
    entries(1),
    shown(1, 0, 1),
    entries(1),
    shown(0, 1, 2),
    shown(1, 1, 1),
  ];
  return stream({ nTiles: 2, nLevels: 2, shDegree: 1, hasPalette: true, rows: rows.flat() });
}

test("by view, picks come after the entries that they need", () => {
  const { directory } = decode(pickedScene(2000));
  const { packets, tiles } = directory;
  tiles.origin.set([0, 0, 0, 5000, 0, 0]);
  for (const near of [0, 1]) {
    const view = { eye: [5000 * near, 0, 0], planes: [near ? [1, 0, 0, -4000] : [-1, 0, 0, 1000]] };
    tiles.boxMin.fill(-10);
    tiles.boxMax.fill(10);
    const order = [...viewOrder(view)(directory)];
    assert.equal(order.length, packets.length);
    assert.ok(order.some((i, k) => i !== k));
    const came = new Set();
    for (const i of order) {
      for (let q = 0; q < packets.length; q++) {
        const isBefore = q < i && packets.label[q] <= packets.label[i];
        const isEntries = packets.component[i] === PICKS && packets.component[q] === PALETTE && isBefore;
        if (isEntries || packets.next[q] === i || packets.core[i] === q) assert.ok(q === i || came.has(q));
      }
      came.add(i);
    }
  }
});

test("picks whose entries are beyond the budget are left out, and no others", () => {
  const { directory } = decode(pickedScene(2000));
  const { packets } = directory;
  const last = packets.length - 5;
  assert.equal(packets.component[last], PALETTE);
  const taken = [...fileOrder({ bytes: packets.end - packets.size[last] })(directory)];
  assert.ok(!taken.includes(last));
  const all = Array.from({ length: packets.length }, (_, i) => i);
  const isLeft = (i) => i === last || (i > last && packets.component[i] === PICKS);
  assert.deepEqual(
    taken,
    all.filter((i) => !isLeft(i)),
  );
  assert.ok(taken.some((i) => i < last && packets.component[i] === PICKS) && taken.at(-1) === packets.length - 2);
  assert.equal(packets.component[packets.length - 2], CORE);
});

test("by view tiles come first that cover much of the picture, also one around the viewer", () => {
  const { directory } = decode(FILE);
  const { packets, tiles } = directory;
  // At (0, 0, 0), looking along x: [low, high] of boxes.
  const boxes = [
    [
      [-1000, -1000, -1000],
      [1000, 1000, 1000],
    ], // around the viewer, and far behind what is looked at
    [
      [100, -5, -5],
      [110, 5, 5],
    ], // a hundredth of the picture
    [
      [100, -50, -50],
      [110, 50, 0],
    ], // half of it
    [
      [-110, -50, -50],
      [-100, 50, 50],
    ], // behind the viewer
  ];
  for (const [t, [low, high]] of boxes.entries()) {
    tiles.origin.set([0, 0, 0], 3 * t);
    tiles.boxMin.set(low, 3 * t);
    tiles.boxMax.set(high, 3 * t);
  }
  const planes = [
    [0.5, 1, 0, 0],
    [0.5, -1, 0, 0],
    [0.5, 0, 1, 0],
    [0.5, 0, -1, 0],
  ];
  const order = [...viewOrder({ eye: [0, 0, 0], planes })(directory)];
  const of = (...some) => order.filter((i) => some.includes(packets.tile[i]));
  // In the order of the file among each other.
  for (const pair of [of(0, 2), of(1, 3)])
    assert.deepEqual(
      pair,
      pair.toSorted((a, b) => a - b),
    );
  const place = (some) => some.reduce((sum, i) => sum + order.indexOf(i), 0) / some.length;
  const inFile = (some) => some.reduce((sum, i) => sum + i, 0) / some.length;
  assert.ok(place(of(0, 2)) < inFile(of(0, 2)) - 2, order.join());
  assert.ok(place(of(1, 3)) > inFile(of(1, 3)) + 2, order.join());
});

test("what is on its way and not wanted any more is cancelled; what came of it is kept", () => {
  const file = scene(6000);
  return withServer(file, { bytesPerSecond: 600000 }, async ({ url, log }) => {
    const decoder = new Decoder();
    const { packets } = decode(file).directory;
    const reversed = ({ packets: { length } }) => Array.from({ length }, (_, i) => length - 1 - i);
    const fetcher = new SceneFetch(url, decoder, QUICK);
    const running = fetcher.run();
    while (fetcher.received < 400000) await new Promise((resolve) => setTimeout(resolve, 5));
    fetcher.want(reversed);
    await running;
    const asked = log.requests.map((range) => Number(/\d+/.exec(range)[0]));
    // The request that was cancelled began before the middle, and so does the last one, which takes it up.
    const middle = packets.end / 2;
    assert.ok(asked[1] < middle && asked[2] > middle && asked[asked.length - 1] < middle, log.requests.join());
    assert.equal(fetcher.repeated, 0);
    assert.equal(fetcher.received, file.length);
    assertWhole(decoder, file);
  });
});

test("a limit of bytes for each second, and a pause", () =>
  withServer(FILE, {}, async ({ url }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, { ...QUICK, bytesPerSecond: 200000 });
    const running = fetcher.run();
    await new Promise((resolve) => setTimeout(resolve, 500));
    const half = fetcher.received;
    assert.ok(half > 40000 && half < 140000, `${half}`);
    fetcher.pause();
    await new Promise((resolve) => setTimeout(resolve, 100));
    const paused = fetcher.received;
    await new Promise((resolve) => setTimeout(resolve, 200));
    assert.equal(fetcher.received, paused);
    fetcher.bytesPerSecond = Number.POSITIVE_INFINITY;
    fetcher.resume();
    await running;
    assertWhole(decoder);
  }));

test("stop ends a run, and the next run goes on", () =>
  withServer(FILE, { bytesPerSecond: 500000 }, async ({ url, state }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, QUICK);
    const running = fetcher.run();
    await new Promise((resolve) => setTimeout(resolve, 200));
    fetcher.stop();
    await running;
    assert.equal(fetcher.state, "stopped");
    assert.ok(fetcher.received < FILE.length);
    state.bytesPerSecond = undefined;
    await fetcher.run();
    assert.equal(fetcher.repeated, 0);
    assertWhole(decoder);
  }));

test("at 10 Mbit/s a file of 5 MB takes at most 40 requests", () => {
  const file = scene(19000);
  assert.ok(file.length > 5e6);
  return withServer(file, { bytesPerSecond: 1.25e6 }, async ({ url, log }) => {
    const decoder = new Decoder();
    const fetcher = new SceneFetch(url, decoder, QUICK);
    await fetcher.run();
    assert.ok(log.requests.length <= 40, `${log.requests.length}`);
    assert.equal(log.sent, file.length);
    assert.equal(fetcher.received, file.length);
  });
});

test("sets of ranges", () => {
  const random = chance(3);
  const set = new Intervals();
  const bits = new Uint8Array(200);
  for (let k = 0; k < 300; k++) {
    const start = random(200);
    const end = start + random(200 - start) * (random(4) === 0 ? 1 : 0) + random(4);
    set.add(start, Math.min(end, 200));
    bits.fill(1, start, Math.min(end, 200));
    assert.equal(
      set.total,
      bits.reduce((a, b) => a + b, 0),
    );
    const from = random(200);
    const to = from + random(200 - from);
    const missing = bits.slice();
    for (const { start: s, end: e } of set.missing(from, to)) {
      assert.ok(s < e && s >= from && e <= to);
      for (let i = s; i < e; i++) assert.equal(missing[i]++, 0);
    }
    assert.ok(missing.subarray(from, to).every((bit) => bit === 1));
    assert.equal(
      set.has(from, to),
      bits.subarray(from, to).every((bit) => bit === 1),
    );
    if (k % 40 === 39) {
      bits.fill(0);
      Object.assign(set, new Intervals());
    }
  }
});
