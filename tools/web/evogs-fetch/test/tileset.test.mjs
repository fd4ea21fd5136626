import assert from "node:assert/strict";
import { test } from "node:test";
import { FetchError, TilesetFetch, chooseTiles, screenError, tilesToDraw } from "../dist/index.js";
import { serve } from "./server.mjs";

const FAR = [500_000, 5_400_000, 250];
const BASE = "https://example.org/city/tileset.json";
const moved = (x, y, z) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
const box = (x, half) => ({ box: [x, 0, 0, half, 0, 0, 0, half, 0, 0, 0, half] });
const leaf = (name, x) => ({
  transform: moved(x, 0, 0),
  boundingVolume: box(0, 1),
  geometricError: 0,
  content: { uri: `${name}.evogs`, extras: { splats: 100, bytes: 1000 } },
});

/** A root with a leaf on the left, and on the right a node with two leaves, in a file of its own. */
function files() {
  const root = {
    asset: { version: "1.1" },
    geometricError: 50,
    extras: { evogs: { origin: FAR } },
    root: {
      transform: [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, ...FAR, 1],
      boundingVolume: box(0, 30),
      geometricError: 2,
      refine: "REPLACE",
      content: { uri: "tiles/root.evogs", extras: { splats: 50, bytes: 500 } },
      children: [
        leaf("tiles/0", -10),
        {
          transform: moved(10, 0, 0),
          boundingVolume: box(0, 15),
          geometricError: 1,
          content: { uri: "tiles/1.json" },
        },
      ],
    },
  };
  const right = {
    asset: { version: "1.1" },
    geometricError: 1,
    root: {
      boundingVolume: box(0, 15),
      geometricError: 1,
      refine: "REPLACE",
      content: { uri: "1.evogs", extras: { splats: 50, bytes: 500 } },
      children: [leaf("1-0", -5), leaf("1-1", 5)],
    },
  };
  return { "/city/tileset.json": root, "/city/tiles/1.json": right };
}

function fetchOf(found, asked = []) {
  return async (url) => {
    asked.push(url);
    const { pathname } = new URL(url);
    const file = found[pathname];
    if (file === undefined) return new Response("", { status: 404 });
    return new Response(typeof file === "string" ? file : JSON.stringify(file));
  };
}

async function opened(found = files(), asked = []) {
  const tileset = new TilesetFetch(BASE, { fetch: fetchOf(found, asked) });
  return { tileset, root: await tileset.open(), asked };
}

const ALL = { eye: [FAR[0], FAR[1], FAR[2] + 40], planes: [], pixels: 1000 };
const nameOf = ({ url }) => url?.replace("https://example.org/city/tiles/", "") ?? null;

test("tiles have their places in the scene, and files of tiles come when they are asked for", async () => {
  const { tileset, root, asked } = await opened();
  assert.deepEqual(root.origin, FAR);
  assert.equal(tileset.matrix[6], 1);
  const [left, right] = root.children;
  assert.deepEqual(left.origin, [FAR[0] - 10, FAR[1], FAR[2]]);
  assert.deepEqual([left.splats, left.bytes, nameOf(left)], [100, 1000, "0.evogs"]);
  assert.deepEqual([right.url, right.children.length], [null, 0]);
  assert.equal(asked.length, 1);
  await Promise.all([tileset.load(right), tileset.load(right)]);
  assert.equal(asked.length, 2);
  assert.deepEqual([right.external, nameOf(right)], [null, "1.evogs"]);
  assert.deepEqual(right.children.map(nameOf), ["1-0.evogs", "1-1.evogs"]);
  assert.deepEqual(right.children[1].origin, [FAR[0] + 15, FAR[1], FAR[2]]);
  assert.equal(right.children[0].parent, right);
  assert.equal(right.parent, root);
  assert.equal(tileset.requests, 2);
  assert.ok(tileset.received > 500);
});

test("the overview comes first, and tiles are replaced where their error is seen", async () => {
  const { tileset, root } = await opened();
  const away = { ...ALL, eye: [FAR[0], FAR[1], FAR[2] + 1e6] };
  assert.ok(screenError(root, away) < 1);
  assert.deepEqual(chooseTiles(root, away).tiles.map(nameOf), ["root.evogs"]);
  const first = chooseTiles(root, ALL);
  assert.deepEqual(first.tiles.map(nameOf), ["0.evogs"]);
  assert.deepEqual(first.load, [root.children[1]]);
  await tileset.load(root.children[1]);
  const near = chooseTiles(root, { ...ALL, eye: [FAR[0] + 15, FAR[1], FAR[2] + 20] });
  assert.deepEqual(near.tiles.map(nameOf), ["1-1.evogs", "1-0.evogs", "0.evogs"]);
  assert.deepEqual(near.load, []);
});

test("no more splats or bytes are wanted than the budget has", async () => {
  const { tileset, root } = await opened();
  await tileset.load(root.children[1]);
  const names = (budget) => chooseTiles(root, ALL, budget).tiles.map(nameOf).sort();
  assert.deepEqual(names({ splats: 100 }), ["root.evogs"]);
  assert.deepEqual(names({ splats: 150 }), ["0.evogs", "1.evogs"]);
  assert.deepEqual(names({ splats: 299 }), ["0.evogs", "1.evogs"]);
  assert.deepEqual(names({ bytes: 2999 }), ["0.evogs", "1.evogs"]);
  assert.deepEqual(names({ splats: 300 }), ["0.evogs", "1-0.evogs", "1-1.evogs"]);
  assert.deepEqual(names({ error: 1000 }), ["root.evogs"]);
});

test("what is out of sight is not wanted", async () => {
  const { tileset, root } = await opened();
  await tileset.load(root.children[1]);
  const right = chooseTiles(root, { ...ALL, planes: [[1, 0, 0, -FAR[0] - 12]] });
  assert.deepEqual(right.tiles.map(nameOf), ["1-1.evogs"]);
});

test("an overview stays until all that is wanted below it has come", async () => {
  const { tileset, root } = await opened();
  await tileset.load(root.children[1]);
  const wanted = chooseTiles(root, ALL).tiles;
  assert.equal(wanted.length, 3);
  const drawn = (...ready) =>
    tilesToDraw(wanted, (tile) => ready.includes(nameOf(tile)))
      .map(nameOf)
      .sort();
  assert.deepEqual(drawn(), []);
  assert.deepEqual(drawn("root.evogs"), ["root.evogs"]);
  assert.deepEqual(drawn("root.evogs", "0.evogs"), ["root.evogs"]);
  assert.deepEqual(drawn("root.evogs", "0.evogs", "1.evogs", "1-0.evogs"), ["0.evogs", "1.evogs"]);
  assert.deepEqual(drawn("0.evogs", "1-0.evogs", "1-1.evogs"), ["0.evogs", "1-0.evogs", "1-1.evogs"]);
});

for (const [what, change] of [
  ["another version", (t) => Object.assign(t.asset, { version: "2.0" })],
  ["no root", (t) => Reflect.deleteProperty(t, "root")],
  ["a list in place of a tile", (t) => Object.assign(t, { root: [] })],
  ["a sphere", (t) => Object.assign(t.root, { boundingVolume: { sphere: [0, 0, 0, 1] } })],
  ["a negative error", (t) => Object.assign(t.root, { geometricError: -1 })],
  ["a number that is none", (t) => Object.assign(t.root, { geometricError: "1" })],
  ["another host", (t) => Object.assign(t.root.content, { uri: "https://example.com/a.evogs" })],
  ["another folder", (t) => Object.assign(t.root.content, { uri: "../other/a.evogs" })],
  ["a file of the disk", (t) => Object.assign(t.root.content, { uri: "file:///etc/passwd" })],
  ["a turned tile", (t) => Object.assign(t.root.children[0], { transform: Array(16).fill(2) })],
  ["implicit tiles", (t) => Object.assign(t.root, { implicitTiling: {} })],
]) {
  test(`a tileset with ${what} is refused`, async () => {
    const found = files();
    change(found["/city/tileset.json"]);
    await assert.rejects(opened(found), (error) => error instanceof FetchError && error.kind === "bad");
  });
}

test("what is not there, no JSON, or among its own tiles is refused; what is not there can be asked for again", async () => {
  await assert.rejects(opened({}), (error) => error.kind === "status" && error.status === 404);
  await assert.rejects(opened({ "/city/tileset.json": "{" }), (error) => error.kind === "bad");
  const found = files();
  const right = found["/city/tiles/1.json"];
  Reflect.deleteProperty(found, "/city/tiles/1.json");
  const { tileset, root } = await opened(found);
  await assert.rejects(tileset.load(root.children[1]), (error) => error.kind === "status");
  found["/city/tiles/1.json"] = right;
  right.root.children[0].content.uri = "1.json";
  await tileset.load(root.children[1]);
  const [again] = root.children[1].children;
  await assert.rejects(tileset.load(again), /among its own tiles/);
});

const JSON_BYTES = new TextEncoder().encode(JSON.stringify(files()["/city/tileset.json"]));

/** The tileset of a server that misbehaves, and what its requests failed with. `onFailure` is called for each. */
async function withTileset(behaviour, options, use, onFailure = () => {}) {
  const server = await serve(JSON_BYTES, behaviour);
  const failures = [];
  const tileset = new TilesetFetch(server.url, {
    backOff: 5,
    onFailure: () => {
      failures.push(tileset.failure?.message ?? null);
      onFailure(failures.length, server.state);
    },
    ...options,
  });
  try {
    await use(tileset, server, failures);
  } finally {
    await server.close();
  }
}

const recover = (state) => Object.assign(state, { endless: false, flaky: 0, status: 0 });

for (const [what, behaviour, options] of [
  ["an answer that does not come", { endless: true }, { stallSeconds: 0.1 }],
  ["a lost connection", { flaky: 99 }, {}],
  ["an answer of 503", { status: 503 }, {}],
]) {
  test(`after ${what} the tileset is asked for again`, () =>
    withTileset(
      behaviour,
      options,
      async (tileset, _server, failures) => {
        const root = await tileset.open();
        assert.equal(root.children.length, 2);
        assert.equal(tileset.received, JSON_BYTES.length);
        assert.equal(failures.length, tileset.requests);
        assert.ok(failures.length > 2 && failures.slice(0, -1).every((failure) => failure !== null));
        assert.equal(failures.at(-1), null);
      },
      (n, state) => n === 2 && recover(state),
    ));

  test(`after ${what} the tileset is given up at last, and can be asked for again`, () =>
    withTileset(behaviour, { ...options, retries: 2 }, async (tileset, { state }) => {
      const status = behaviour.status ?? 0;
      await assert.rejects(tileset.open(), { name: "FetchError", kind: "lost", status });
      assert.equal(tileset.requests, 3);
      assert.ok(tileset.failure);
      recover(state);
      await tileset.open();
      assert.equal(tileset.failure, null);
    }));
}

test("an answer whose connection is lost midway is asked for again", () =>
  withTileset({ bytesPerSecond: 10000, dropAfter: 300 }, {}, async (tileset, _server, failures) => {
    await tileset.open();
    assert.equal(tileset.requests, 2);
    assert.equal(tileset.received, JSON_BYTES.length);
    assert.equal(failures.at(-1), null);
  }));

test("a signal ends a request, and the wait before another try", async () => {
  const enough = new Error("enough");
  const first = new AbortController();
  await withTileset({ endless: true }, { signal: first.signal }, async (tileset) => {
    setTimeout(() => first.abort(enough), 50);
    await assert.rejects(tileset.open(), enough);
    await assert.rejects(tileset.open(), enough);
    assert.equal(tileset.requests, 1);
  });
  const second = new AbortController();
  await withTileset(
    { status: 503 },
    { signal: second.signal, backOff: 60000 },
    async (tileset) => {
      await assert.rejects(tileset.open(), enough);
      assert.equal(tileset.requests, 1);
    },
    () => setTimeout(() => second.abort(enough), 20),
  );
});

test("a tileset that is no text is refused at once", async () => {
  const server = await serve(Uint8Array.of(0xff, 0xfe, 0x7b));
  try {
    await assert.rejects(new TilesetFetch(server.url).open(), { kind: "bad" });
    assert.equal(server.log.requests.length, 1);
  } finally {
    await server.close();
  }
});
