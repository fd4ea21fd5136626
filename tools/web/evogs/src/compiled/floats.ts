/** The float view (spec 7.6) of a whole file, by the engine. */

import type { Directory } from "../directory.js";
import { CORE, N_CORE, PICKS, channelCount, channelsOf, groupOf } from "../model.js";
import { type Engine, need } from "./engine.js";
import type { Sink } from "./tile.js";

const SIDE_BY_SIDE = 4;
/** Floats up to these bytes are gathered in the memory of the engine: arrays that are copied are not cleared first. */
const MOST_GATHERED = 32 * 1024 * 1024;

/** Takes tiles, and makes the floats of their live splats. */
export class FloatSink implements Sink {
  private readonly view: Float32Array[];
  /** Live splats of the tiles before, and of this one; and its live slots, 0 if all are. */
  private from = 0;
  private nLive = 0;
  private slotsAt = 0;
  private tile = -1;
  private nSteps = 0;
  /** Components of the tile that came. */
  private nComponents = 0;
  /** Tables of the palette, of four channels side by side; and picks of all live splats. */
  private readonly tables: number[] = [];
  private picksAt = 0;
  /** Where the floats of a channel are gathered, and bytes from one to the next. */
  private readonly gatheredAt: number = 0;
  private readonly stride: number;

  constructor(
    private readonly engine: Engine,
    private readonly directory: Directory,
    /** Live splats of all tiles. */
    private readonly n: number,
  ) {
    const { hasPalette, shDegree } = directory.header;
    const nOwn = hasPalette ? N_CORE : channelCount(shDegree);
    this.stride = 4 * (n + SIDE_BY_SIDE);
    if (nOwn * this.stride <= MOST_GATHERED) this.gatheredAt = engine.take(nOwn * this.stride);
    if (hasPalette) this.picksAt = engine.take(this.stride);
    this.view = Array.from({ length: nOwn }, () => new Float32Array(this.gatheredAt ? 0 : n));
  }

  palette(data: number, n: number): void {
    const { engine, tables } = this;
    const { kernels } = engine;
    const { count } = channelsOf(PICKS, this.directory.header.shDegree);
    // An entry of 0 stands before the others.
    const stride = 4 * (1 + n + SIDE_BY_SIDE);
    for (let k = 0; k < count; k += SIDE_BY_SIDE) {
      const mixed = engine.takeIntegers(SIDE_BY_SIDE * (1 + n));
      const mark = engine.mark();
      const table = engine.take(SIDE_BY_SIDE * stride);
      for (let c = 0; c < SIDE_BY_SIDE && k + c < count; c++) {
        const at = table + c * stride;
        engine.integers[at >> 2] = 0;
        kernels.toFloats(data + 4 * n * (k + c), n, 0, this.unitOf(N_CORE), at + 4);
      }
      kernels.mixFour(table, stride, 1 + n, mixed);
      engine.release(mark);
      tables.push(mixed);
    }
  }

  slots(t: number, live: number, n: number): void {
    const { engine } = this;
    this.endTile();
    this.tile = t;
    this.slotsAt = engine.takeIntegers(n + 1);
    this.nLive = engine.kernels.liveSlots(live, n, this.slotsAt);
    if (this.nLive === n) this.slotsAt = 0;
    need(this.from + this.nLive <= this.n);
  }

  component(component: number, data: number, n: number, steps: number): void {
    const { engine, from, gatheredAt, nLive, view } = this;
    const { header, tiles } = this.directory;
    if (component === CORE) this.nSteps = steps;
    // What is late shows other numbers (7.5).
    need(steps === this.nSteps);
    this.nComponents++;
    const { first, count } = channelsOf(component, header.shDegree);
    if (component === PICKS) {
      this.gather(data);
      engine.at(this.picksAt + 4 * from, nLive).set(engine.at(data, nLive));
      return;
    }
    // Loops write up to 3 too many: the last channel comes first.
    for (let k = count - 1; k >= 0; k--) {
      const channel = first + k;
      const origin = channel < 3 ? tiles.origin[3 * this.tile + channel] : 0;
      const at = data + 4 * n * k;
      const out = gatheredAt ? gatheredAt + channel * this.stride + 4 * from : at;
      this.gather(at);
      engine.kernels.toFloats(at, nLive, origin, this.unitOf(channel), out);
      if (!gatheredAt) view[channel].set(engine.floats.subarray(out >> 2, (out >> 2) + nLive), from);
    }
  }

  /** The floats, behind the last tile. */
  end(): Float32Array[] {
    const { engine, n, gatheredAt, picksAt, stride } = this;
    this.endTile();
    need(this.from === n);
    const view = gatheredAt ? this.view.map((_, k) => this.copyOf(gatheredAt + k * stride)) : this.view;
    if (picksAt === 0) return view;
    // All are taken four at a time.
    engine.at(picksAt + 4 * n, SIDE_BY_SIDE).fill(0);
    const out = engine.take(SIDE_BY_SIDE * stride);
    for (const table of this.tables) {
      engine.kernels.gatherFour(table, picksAt, n, out, stride);
      for (let c = 0; c < SIDE_BY_SIDE && view.length < channelCount(this.directory.header.shDegree); c++) {
        view.push(this.copyOf(out + stride * c));
      }
    }
    return view;
  }

  private endTile(): void {
    const { hasPalette, shDegree } = this.directory.header;
    need(this.tile < 0 || this.nComponents === 1 + (hasPalette ? 1 : shDegree));
    this.from += this.nLive;
    this.nComponents = 0;
  }

  /** The numbers of live slots, in place: a slot is never below its place among them. */
  private gather(at: number): void {
    if (this.slotsAt !== 0) this.engine.kernels.gather(at, this.slotsAt, this.nLive, at);
  }

  private copyOf(at: number): Float32Array {
    return this.engine.floats.slice(at >> 2, (at >> 2) + this.n);
  }

  private unitOf(channel: number): number {
    return 2 ** -this.directory.header.gridExponents[groupOf(channel)];
  }
}
