/**
 * The loops of kernels/ in WebAssembly, and the memory that they work on. A tile is decoded there, and copied
 * out. Between two calls of this package the memory holds nothing.
 */

import { StreamError } from "../faults.js";
import { MODULE } from "./module.js";

/** The exports of kernels/index.ts. Arguments are addresses and integers; a boolean comes back as 0 or 1. */
type Kernel = (...values: number[]) => number;
const NAMES = [
  "addDelta",
  "addDeltaEach",
  "addSiblings",
  "addSiblingsEach",
  "areBelow",
  "areWithin",
  "clearBytes",
  "clearSlots",
  "crc32",
  "decompress",
  "gather",
  "gatherFour",
  "inverseYcocg",
  "liveSlots",
  "mixFour",
  "readSlots",
  "runsOf",
  "setSlots",
  "siblingsOf",
  "sortRecords",
  "toFloats",
  "undelta",
  "unpack",
  "unpackSigned",
  "valuesOf",
  "writeSeconds",
] as const;
export type Kernels = Record<(typeof NAMES)[number], Kernel>;

interface Exports extends Kernels {
  memory: WebAssembly.Memory;
  heapBase: WebAssembly.Global;
}

const PAGE = 65536;
/** Addresses stay below this: kernels count bits in 32 bits. */
const MOST_BYTES = 256 * 1024 * 1024;
/** Memory above this is given back. */
const KEPT_BYTES = 96 * 1024 * 1024;
/** Kernels touch up to this many bytes behind an array. */
const SLACK = 128;

/** The plain code has to decode it: a fault, or more memory than there is. */
export class NotCompiled extends Error {}

export function need(isGood: number | boolean): void {
  if (!isGood) throw new NotCompiled();
}

export class Engine {
  /** All memory. Arrays taken later may make these anew. */
  bytes = new Uint8Array(0);
  integers = new Int32Array(0);
  floats = new Float32Array(0);
  private readonly base: number;
  private top: number;

  constructor(readonly kernels: Exports) {
    this.base = kernels.heapBase.value;
    this.top = this.base;
    this.look();
  }

  /** The address of `n` bytes that hold anything, at a multiple of 16. */
  take(n: number): number {
    const at = this.top;
    this.top = (at + n + SLACK + 15) & ~15;
    need(n < MOST_BYTES && this.top <= MOST_BYTES);
    const { memory } = this.kernels;
    const missing = this.top - memory.buffer.byteLength;
    if (missing > 0) {
      // By a quarter at least, so that memory that grows by little is not made anew each time.
      const pages = Math.max(Math.ceil(missing / PAGE), memory.buffer.byteLength / PAGE / 4);
      memory.grow(Math.ceil(pages));
      this.look();
    }
    return at;
  }

  /** The address of `n` integers that hold anything. */
  takeIntegers(n: number): number {
    return this.take(4 * n);
  }

  /** The address of a copy. */
  put(array: Int32Array | Int16Array): number {
    const at = this.take(array.byteLength);
    this.bytes.set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength), at);
    return at;
  }

  /** The `n` integers at an address, until the next array is taken. */
  at(address: number, n: number): Int32Array {
    return this.integers.subarray(address >> 2, (address >> 2) + n);
  }

  /** A mark for `release`. */
  mark(): number {
    return this.top;
  }

  /** Arrays taken since the mark are let go. */
  release(mark: number): void {
    this.top = mark;
  }

  private look(): void {
    const { buffer } = this.kernels.memory;
    this.bytes = new Uint8Array(buffer);
    this.integers = new Int32Array(buffer);
    this.floats = new Float32Array(buffer);
  }
}

let module: WebAssembly.Module | null | undefined;
let engine: Engine | null = null;
let isAllowed = true;

/** What `work` returns; null if there is no WebAssembly, or if it finds a fault or throws NotCompiled. */
export function withEngine<T>(work: (engine: Engine) => T): T | null {
  engine ??= newEngine();
  if (engine === null || !isAllowed) return null;
  const mark = engine.mark();
  try {
    return work(engine);
  } catch (error) {
    // A RangeError: memory did not grow.
    if (error instanceof StreamError || error instanceof NotCompiled || error instanceof RangeError) return null;
    throw error;
  } finally {
    engine.release(mark);
    if (engine.bytes.length > KEPT_BYTES) engine = null;
  }
}

/** For tests: whether WebAssembly is used where it is there. */
export function allowWebAssembly(flag: boolean): void {
  isAllowed = flag;
}

/** Null where WebAssembly, or its vector instructions, are not there or are refused. */
function newEngine(): Engine | null {
  try {
    module ??= module === null ? null : new WebAssembly.Module(bytesOf(MODULE));
    return module && new Engine(new WebAssembly.Instance(module).exports as unknown as Exports);
  } catch {
    module = null;
    return null;
  }
}

/** The bytes of a text in base 16. */
function bytesOf(text: string): Uint8Array {
  return Uint8Array.from({ length: text.length / 2 }, (_, i) => Number.parseInt(text.slice(2 * i, 2 * i + 2), 16));
}
