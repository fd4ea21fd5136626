#!/usr/bin/env node
/** A decoder under test, by the contract of conformance/README.md. */

import { closeSync, openSync, readFileSync, rmSync, writeSync } from "node:fs";
import { createInterface } from "node:readline";
import { dumpPieces } from "../dist/index.js";
import { MISUSED, judge } from "./judge.mjs";

const CAPABILITIES = {
  name: "evogs-web",
  version: "0.1.0",
  modes: ["file", "progressive"],
  codes: true,
  verify: true,
  limits: true,
  arrival: true,
  dump_on_fault: true,
  batch: true,
  max_tier: 3,
  max_sh_degree: 3,
};
const BROKEN = 70;
/** Options with a value, and without one. */
const WITH_VALUE = ["in", "out", "mode", "level", "limits", "arrival"];
const SWITCHES = ["verify", "dump_on_fault"];
const CHUNK = 1 << 20;

/** Writes a dump in pieces: it may be much larger than the file. */
function writeDump(scene, path) {
  const file = openSync(path, "w");
  try {
    const buffer = new Uint8Array(CHUNK);
    let filled = 0;
    const flush = (bytes) => {
      for (let at = 0; at < bytes.length; ) at += writeSync(file, bytes, at, bytes.length - at);
    };
    for (const piece of dumpPieces(scene)) {
      if (filled + piece.length > CHUNK) {
        flush(buffer.subarray(0, filled));
        filled = 0;
      }
      if (piece.length > CHUNK) flush(piece);
      else {
        buffer.set(piece, filled);
        filled += piece.length;
      }
    }
    flush(buffer.subarray(0, filled));
  } finally {
    closeSync(file);
  }
}

/** The exit status of a request, with the fault if there is one. */
function answer(request) {
  try {
    const json = (path) => path && JSON.parse(readFileSync(path, "utf8"));
    const { limits, arrival } = request;
    const bytes = readFileSync(request.in);
    const { scene, ...verdict } = judge({ ...request, limits: json(limits), arrival: json(arrival) }, bytes);
    if (scene) writeDump(scene, request.out);
    return verdict;
  } catch (error) {
    // No verdict on the stream: say out of memory, or a mistake of this program.
    console.error(error?.stack ?? String(error));
    if (request.out) rmSync(request.out, { force: true });
    return { exit: BROKEN };
  }
}

async function runBatch() {
  for await (const line of createInterface({ input: process.stdin })) {
    if (line.trim() === "") continue;
    const request = JSON.parse(line);
    writeSync(1, `${JSON.stringify({ id: request.id, ...answer(request) })}\n`);
  }
}

/** The request of a command line, or null if it has words that the contract does not know. */
function parseArguments(words) {
  const request = {};
  for (let i = 0; i < words.length; i++) {
    if (!words[i].startsWith("--")) return null;
    const name = words[i].slice(2).replaceAll("-", "_");
    if (SWITCHES.includes(name)) request[name] = true;
    else if (WITH_VALUE.includes(name) && i + 1 < words.length) request[name] = words[++i];
    else return null;
  }
  if (request.level !== undefined) {
    if (!/^-?\d+$/.test(request.level)) return null;
    request.level = Number(request.level);
  }
  const isWhole = request.in && request.out && ["file", "progressive"].includes(request.mode);
  const isFile = request.mode === "file";
  return isWhole && !(isFile && (request.arrival || request.dump_on_fault)) ? request : null;
}

function runOnce(words) {
  const request = parseArguments(words);
  if (request === null) {
    console.error("usage: decoder.mjs --in FILE --out OUT --mode file|progressive ...");
    return MISUSED;
  }
  const { exit, code, offset } = answer(request);
  if (code !== undefined) writeSync(1, `${JSON.stringify({ code, offset })}\n`);
  return exit;
}

const words = process.argv.slice(2);
if (words.length === 1 && words[0] === "--capabilities") writeSync(1, `${JSON.stringify(CAPABILITIES)}\n`);
else if (words.length === 1 && words[0] === "--batch") await runBatch();
else process.exitCode = runOnce(words);
