/** The float view (spec 7.6) in the loops of the engine: numbers are copied to its memory, and floats from it. */

import type { ChannelPart, FloatLoops } from "../floatView.js";
import type { Engine } from "./engine.js";

/** Numbers at once: few enough for the cache. */
const CHUNK = 1 << 13;
const SIDE_BY_SIDE = 4;

export function compiledLoops(engine: Engine): FloatLoops {
  const { kernels } = engine;
  return {
    channel(parts, n) {
      const mark = engine.mark();
      const out = engine.takeIntegers(n);
      let at = out;
      for (const part of parts) {
        writePart(engine, part, at);
        at += 4 * (part.slots ?? part.numbers).length;
      }
      const floats = floatsAt(engine, out, n);
      engine.release(mark);
      return floats;
    },

    picked(channels, unit, picks) {
      const mark = engine.mark();
      const places = engine.put(picks);
      const n = picks.length;
      // All are taken four at a time.
      engine.at(places + 4 * n, SIDE_BY_SIDE).fill(0);
      const stride = 4 * (n + SIDE_BY_SIDE);
      const out = engine.take(SIDE_BY_SIDE * stride);
      const nEntries = 1 + (channels[0]?.length ?? 0);
      const tableSize = 4 * (nEntries + SIDE_BY_SIDE);
      const tables = engine.take(SIDE_BY_SIDE * tableSize);
      const mixed = engine.takeIntegers(SIDE_BY_SIDE * nEntries);
      const view: Float32Array[] = [];
      for (let k = 0; k < channels.length; k += SIDE_BY_SIDE) {
        const group = channels.slice(k, k + SIDE_BY_SIDE);
        group.forEach((numbers, c) => {
          const table = tables + c * tableSize;
          engine.integers[table >> 2] = 0;
          engine.integers.set(numbers, (table >> 2) + 1);
          kernels.toFloats(table, nEntries, 0, unit, table);
        });
        kernels.mixFour(tables, tableSize, nEntries, mixed);
        kernels.gatherFour(mixed, places, n, out, stride);
        group.forEach((_, c) => view.push(floatsAt(engine, out + stride * c, n)));
      }
      engine.release(mark);
      return view;
    },
  };
}

function writePart(engine: Engine, { numbers, slots, origin, unit }: ChannelPart, out: number): void {
  const { kernels } = engine;
  const mark = engine.mark();
  if (slots !== null) {
    kernels.gather(engine.put(numbers), engine.put(slots), slots.length, out);
    kernels.toFloats(out, slots.length, origin, unit, out);
  } else {
    const chunk = engine.takeIntegers(CHUNK);
    for (let from = 0; from < numbers.length; from += CHUNK) {
      const part = numbers.subarray(from, from + CHUNK);
      engine.integers.set(part, chunk >> 2);
      kernels.toFloats(chunk, part.length, origin, unit, out + 4 * from);
    }
  }
  engine.release(mark);
}

/** A copy of floats: an array that is not cleared first, as a new one is. */
function floatsAt(engine: Engine, at: number, n: number): Float32Array {
  return engine.floats.slice(at >> 2, (at >> 2) + n);
}
