// Packets to integers in JavaScript: frames of Zstandard and planes, or blocks of rANS (rans.py).
//
// node javascript.cjs FOLDER TURNS, called by javascript.py; prints seconds by coder. The Zstandard
// libraries are those that node finds (NODE_PATH): fzstd, JavaScript, and @bokuweb/zstd-wasm.
"use strict";
const fs = require("fs");
const path = require("path");

const N_LANES = 8, TOTAL = 4096, MANTISSA = 3, N_CLASSES = 26, MAX_TOKENS = 256;
const SPLITS = [[4, 1, 1], [5, 2, 1], [6, 3, 1], [7, 4, 1], [8, 4, 1]];
const CONTEXTS = ["none", "neighbour", "channel", "record", "parent", "alpha"];
const BASES = SPLITS.map((split) => basesOf(...split));
const CLASS_OF = Uint8Array.from({ length: 6000 }, (_, m) => classOf(m));

async function main(folder, turns) {
  const jobs = JSON.parse(fs.readFileSync(path.join(folder, "job.json"), "utf8"));
  const data = new Uint8Array(fs.readFileSync(path.join(folder, "job.bin")));
  const contenders = {};
  for (const [name, decompress] of await libraries())
    contenders[`planes, ${name}`] = () => jobs.map((job) => ofFrames(data, job, decompress));
  for (const name of Object.keys(jobs[0].blocks))
    contenders[name] = () => jobs.map((job) => ofBlock(data, job, job.blocks[name]));
  check(Object.values(contenders).map((run) => run()));
  const seconds = {};
  for (let turn = 0; turn <= turns; turn++)
    for (const [name, run] of Object.entries(contenders)) {
      const start = process.hrtime.bigint();
      run();
      if (turn) (seconds[name] ??= []).push(Number(process.hrtime.bigint() - start) / 1e9);
    }
  for (const name in seconds) seconds[name] = median(seconds[name]);
  console.log(JSON.stringify(seconds));
}

async function libraries() {
  const found = [];
  const wasm = optional("@bokuweb/zstd-wasm");
  if (wasm) {
    await wasm.init();
    found.push(["Zstandard in WebAssembly", (frame) => wasm.decompress(frame)]);
  }
  const plain = optional("fzstd");
  if (plain)
    found.push(["Zstandard in JavaScript", (frame, size) => plain.decompress(frame, new Uint8Array(size))]);
  return found;
}

function optional(name) {
  try {
    return require(name);
  } catch {
    return null;
  }
}

function check(results) {
  for (const other of results.slice(1))
    other.forEach((lists, k) =>
      lists.forEach((list, j) => {
        if (list.some((value, i) => value !== results[0][k][j][i]))
          throw new Error(`coders differ in packet ${k}, list ${j}`);
      }),
    );
}

function median(values) {
  return values.sort((a, b) => a - b)[values.length >> 1];
}

// Frames

function ofFrames(data, job, decompress) {
  const planes = new Uint8Array(job.frames.reduce((sum, frame) => sum + frame[2], 0));
  let end = 0;
  for (const [at, size, content] of job.frames) {
    planes.set(decompress(data.subarray(at, at + size), content), end);
    end += content;
  }
  let at = 0;
  return job.lists.map(({ n, low, high }) => {
    const z = new Int32Array(n);
    if (low === 1 || low === 2 || low === 4) {
      const perByte = 8 / low, log = 31 - Math.clz32(perByte), mask = (1 << low) - 1;
      for (let i = 0; i < n; i++) z[i] = (planes[at + (i >> log)] >> ((i & (perByte - 1)) * low)) & mask;
      at += Math.ceil(n / perByte);
    } else if (low) {
      for (let i = 0; i < n; i++) z[i] = planes[at + i];
      at += n;
    }
    for (let k = 0; k < high; k++, at += n) {
      const shift = low + 8 * k;
      for (let i = 0; i < n; i++) z[i] |= planes[at + i] << shift;
    }
    return z;
  });
}

// Blocks

const lookup = new Uint32Array(8 * TOTAL);

function ofBlock(data, job, [offset, size]) {
  const view = new DataView(data.buffer, data.byteOffset + offset, size);
  const nBytes = view.getUint32(0, true);
  const bits = { data: data.subarray(offset + 4, offset + 4 + nBytes + 4), at: 0 };
  const states = Uint32Array.from({ length: N_LANES }, (_, k) => view.getUint32(4 + nBytes + 4 * k, true));
  const first = 4 + nBytes + 4 * N_LANES;
  const words = new Uint16Array((size - first) / 2 + 1);
  for (let k = 0; first + 2 * k < size; k++) words[k] = view.getUint16(first + 2 * k, true);
  let word = 0;
  const lists = [];
  for (const { n, sums } of job.lists) {
    const { split, context, nTokens, tableOf } = readModel(bits);
    const { base, nRaw } = BASES[split];
    const z = new Int32Array(n);
    if (context === "none") word = decodePlain(words, word, states, z);
    else if (context === "neighbour") {
      const tables = Uint8Array.from(base.subarray(0, nTokens), (m) => tableOf[classOf(m)]);
      word = decodeNeighbour(words, word, states, tables, z);
    } else {
      const tables = new Uint8Array(n);
      const [a, b, c] = sums[context].map((k) => lists[k]);
      for (let i = 0; i < n; i++) {
        const m = a[i] + (b ? b[i] : 0) + (c ? c[i] : 0);
        tables[i] = tableOf[CLASS_OF[m < 5999 ? m : 5999]];
      }
      word = decodeKnown(words, word, states, tables, z);
    }
    if (nTokens > 1 << SPLITS[split][0]) joinRaw(bits, base, nRaw, SPLITS[split][2], z);
    lists.push(z);
  }
  return lists;
}

function decodePlain(words, word, states, out) {
  const n = out.length, run = Math.ceil(n / N_LANES);
  for (let row = 0; row < run; row++)
    for (let lane = 0, i = row; lane < N_LANES && i < n; lane++, i += run) {
      const entry = lookup[states[lane] & (TOTAL - 1)];
      let x = rest(states[lane], entry);
      if (x < 65536) x = ((x << 16) | words[word++]) >>> 0;
      states[lane] = x;
      out[i] = entry & 255;
    }
  return word;
}

function decodeNeighbour(words, word, states, tableOfToken, out) {
  const n = out.length, run = Math.ceil(n / N_LANES);
  const tables = new Uint8Array(N_LANES).fill(tableOfToken[0]);
  for (let row = 0; row < run; row++)
    for (let lane = 0, i = row; lane < N_LANES && i < n; lane++, i += run) {
      const entry = lookup[(tables[lane] << 12) | (states[lane] & (TOTAL - 1))];
      let x = rest(states[lane], entry);
      if (x < 65536) x = ((x << 16) | words[word++]) >>> 0;
      states[lane] = x;
      out[i] = entry & 255;
      tables[lane] = tableOfToken[entry & 255];
    }
  return word;
}

function decodeKnown(words, word, states, tables, out) {
  const n = out.length, run = Math.ceil(n / N_LANES);
  for (let row = 0; row < run; row++)
    for (let lane = 0, i = row; lane < N_LANES && i < n; lane++, i += run) {
      const entry = lookup[(tables[i] << 12) | (states[lane] & (TOTAL - 1))];
      let x = rest(states[lane], entry);
      if (x < 65536) x = ((x << 16) | words[word++]) >>> 0;
      states[lane] = x;
      out[i] = entry & 255;
    }
  return word;
}

function rest(x, entry) {
  return (Math.imul(((entry >>> 8) & (TOTAL - 1)) + 1, x >>> 12) + (entry >>> 20)) >>> 0;
}

function joinRaw(bits, base, nRaw, low, out) {
  const { data } = bits;
  let at = bits.at;
  for (let i = 0; i < out.length; i++) {
    const token = out[i], need = nRaw[token], byte = at >>> 3;
    const word = data[byte] | (data[byte + 1] << 8) | (data[byte + 2] << 16) | (data[byte + 3] << 24);
    out[i] = base[token] + (((word >>> (at & 7)) & ((1 << need) - 1)) << low);
    at += need;
  }
  bits.at = at;
}

function readModel(bits) {
  const split = take(bits, 3), context = CONTEXTS[take(bits, 3)];
  const nTables = take(bits, 3) + 1, nTokens = take(bits, 8) + 1;
  const tableOf = new Uint8Array(N_CLASSES).fill(nTables - 1);
  for (let k = 0, first = 0; k < nTables - 1; k++) {
    const last = take(bits, 5);
    tableOf.fill(k, first, last + 1);
    first = last + 1;
  }
  const frequencies = new Int32Array(nTokens);
  for (let k = 0; k < nTables; k++) {
    const greatest = take(bits, 8);
    let left = TOTAL;
    for (let token = 0; token < nTokens; token++) {
      if (token === greatest) continue;
      const length = take(bits, 4), kept = Math.max(Math.min(MANTISSA, length - 1), 0);
      frequencies[token] = length ? (take(bits, kept) | (1 << kept)) << (length - 1 - kept) : 0;
      left -= frequencies[token];
    }
    frequencies[greatest] = left;
    let at = k * TOTAL;
    for (let token = 0; token < nTokens; token++)
      for (let slot = 0; slot < frequencies[token]; slot++)
        lookup[at++] = token | ((frequencies[token] - 1) << 8) | (slot << 20);
  }
  return { split, context, nTokens, tableOf };
}

function take(bits, n) {
  const { data, at } = bits;
  bits.at += n;
  return ((data[at >>> 3] | (data[(at >>> 3) + 1] << 8)) >>> (at & 7)) & ((1 << n) - 1);
}

function basesOf(direct, high, low) {
  const base = new Int32Array(MAX_TOKENS), nRaw = new Uint8Array(MAX_TOKENS);
  for (let token = 0; token < MAX_TOKENS; token++) {
    const above = token - (1 << direct), exponent = direct + (above >> (high + low));
    if (above < 0) base[token] = token;
    else if (exponent < 24) {
      nRaw[token] = exponent - high - low;
      const head = (1 << high) + ((above >> low) & ((1 << high) - 1));
      base[token] = (head << (exponent - high)) | (above & ((1 << low) - 1));
    }
  }
  return { base, nRaw };
}

function classOf(m) {
  return Math.min(Math.floor(2 * Math.log2(1 + m)), N_CLASSES - 1);
}

main(process.argv[2], Number(process.argv[3]));
