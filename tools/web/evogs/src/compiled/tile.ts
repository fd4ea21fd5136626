/**
 * All packets of a tile, or of the palette, at once (spec 7, 12.5), in the memory of the engine. It names no fault:
 * a StreamError or NotCompiled says that the plain code has to decode the file.
 */

import type { Cut } from "../cut.js";
import type { Directory } from "../directory.js";
import { PICKS_OF_CHANGED, type StepCounts } from "../lists.js";
import { CORE, N_COMPONENTS, PALETTE, PICKS, channelsOf } from "../model.js";
import { type Box, boxOf } from "../step.js";
import { ChannelRun, type Step } from "./channels.js";
import { type Engine, need } from "./engine.js";
import { type Lists, readLists, storedOf } from "./lists.js";
import { type Records, findSiblings, noRecords, readRecords } from "./records.js";

const NO_PARENT = -1;

/** What becomes of the numbers of a scene. They are at addresses, for the time of the call. */
export interface Sink {
  /** Comes first, if there is a palette. Its memory is kept to the end. */
  palette(data: number, n: number): void;
  /** The slots of tile `t`, before its components. */
  slots(t: number, live: number, n: number, bornFrom: number): void;
  /** Core, a band or picks of that tile after all of its `steps`; `n` slots had any. */
  component(component: number, data: number, n: number, steps: number): void;
}

/** Decodes a whole file. It throws where that cannot be. */
export function decodeAll(engine: Engine, file: Uint8Array, directory: Directory, cut: Cut, sink: Sink): void {
  const { first, next, label } = directory.packets;
  const chainFrom = (chain: number): number[] => {
    const packets: number[] = [];
    for (let i = first[chain] ?? -1; i >= 0 && label[i] <= cut.level; i = next[i]) packets.push(i);
    return packets;
  };
  const tiles = new CompiledTiles(engine, file, directory, cut, sink);
  if (directory.header.hasPalette) tiles.decodePalette(chainFrom(PALETTE));
  for (let t = 0; t < directory.header.nTiles; t++) {
    const chains = [0, 1, 2, 3, 4].map((component) => chainFrom(t * N_COMPONENTS + component));
    if (chains[CORE].length > 0) tiles.decodeTile(t, chains);
  }
}

class CompiledTiles {
  constructor(
    private readonly engine: Engine,
    private readonly file: Uint8Array,
    private readonly directory: Directory,
    private readonly cut: Cut,
    private readonly sink: Sink,
  ) {}

  /** The entries of the palette, by the packets of its chain. */
  decodePalette(chain: number[]): void {
    let n = 0;
    const steps = chain.map((i) => {
      const counts = this.countsOf(i);
      const step = { records: noRecords(0, counts), lists: this.readLists(i, counts), from: n };
      n += counts.nAdds;
      return step;
    });
    this.sink.palette(this.channels(PALETTE, steps, n, null), n);
  }

  /** A new tile, by the chains of its components 0 to 4. */
  decodeTile(t: number, chains: number[][]): void {
    const { engine } = this;
    const mark = engine.mark();
    const most = this.cut.slots[t];
    const live = engine.take(most);
    const bornFrom = engine.takeIntegers(most);
    const places = engine.takeIntegers(most);
    const records = new Map<number, Records>();
    let n = 0;
    const steps = chains[CORE].map((i) => {
      const step = this.readStep(i, live, bornFrom, places, n);
      records.set(i, step.records);
      n += step.records.nSplits + step.records.nAdds;
      return step;
    });
    this.sink.slots(t, live, n, bornFrom);
    this.sink.component(CORE, this.channels(CORE, steps, n, boxOf(this.directory, t)), n, steps.length);
    for (let component = 1; component <= PICKS; component++) {
      const inner = engine.mark();
      this.decodeBand(component, chains[component], records);
      engine.release(inner);
    }
    engine.release(mark);
  }

  /** An SH band, or picks. */
  private decodeBand(component: number, chain: number[], recordsOf: Map<number, Records>): void {
    if (chain.length === 0) return;
    let n = 0;
    const steps = chain.map((i) => {
      const records = recordsOf.get(this.directory.packets.core[i]) as Records;
      const step = { records, lists: this.readLists(i, records), from: n };
      n += records.nSplits + records.nAdds;
      return step;
    });
    const data = component === PICKS ? this.picks(chain, steps, n) : this.channels(component, steps, n, null);
    this.sink.component(component, data, n, steps.length);
  }

  private picks(chain: number[], steps: Step[], n: number): number {
    const { engine } = this;
    const { kernels } = engine;
    const x = engine.takeIntegers(n);
    for (const [k, { lists, records, from }] of steps.entries()) {
      const { nPsi, psi, nSplits, parents, nAdds, nDrops, drops } = records;
      const nNew = nSplits + nAdds;
      const fresh = x + 4 * from;
      if (lists === null) {
        kernels.gather(x, parents, nSplits, fresh);
        engine.at(fresh + 4 * nSplits, nAdds).fill(0);
      } else {
        const nChanged = (lists.flags & PICKS_OF_CHANGED) !== 0 ? nPsi : 0;
        const picks = storedOf(engine, lists, lists.layout.picks);
        need(kernels.areWithin(picks, nChanged + nNew, 0, this.directory.packets.entriesFor(chain[k])));
        kernels.setSlots(x, psi, nChanged, picks);
        engine.at(fresh, nNew).set(engine.at(picks + 4 * nChanged, nNew));
      }
      kernels.clearSlots(x, drops, nDrops);
    }
    return x;
  }

  /** A step of core: its slots from `from` on are counted in `live` and `bornFrom`. */
  private readStep(i: number, live: number, bornFrom: number, places: number, from: number): Step {
    const { engine } = this;
    const counts = this.countsOf(i);
    const label = this.directory.packets.label[i];
    const lists = this.readLists(i, counts);
    const records =
      lists === null
        ? noRecords(label, counts)
        : readRecords(engine, lists, label, counts, live, from, this.directory.alpha);
    const { nSplits, nAdds, nDrops, nPsi, parents, drops } = records;
    need(lists !== null || nPsi + nDrops === 0);
    engine.at(bornFrom + 4 * from, nSplits).set(engine.at(parents, nSplits));
    engine.at(bornFrom + 4 * (from + nSplits), nAdds).fill(NO_PARENT);
    engine.bytes.fill(1, live + from, live + from + nSplits + nAdds);
    engine.kernels.clearBytes(live, drops, nDrops);
    if (nPsi > 0 && nSplits === 0 && nDrops === 0) findSiblings(engine, records, bornFrom, places);
    return { records, lists, from };
  }

  private channels(component: number, steps: Step[], n: number, box: Box | null): number {
    const { header, quantisers } = this.directory;
    const { first, count } = channelsOf(component, header.shDegree);
    return new ChannelRun(this.engine, quantisers, first, count, steps, n, box).run();
  }

  private countsOf(i: number): StepCounts {
    const { nAdds, nSplits, nRefines, nDrops } = this.directory.packets;
    return { nAdds: nAdds[i], nSplits: nSplits[i], nRefines: nRefines[i], nDrops: nDrops[i] };
  }

  private readLists(i: number, counts: StepCounts): Lists | null {
    const { packets, header } = this.directory;
    const { offset, size, crc, component } = packets;
    if (size[i] === 0) return null;
    const bytes = this.file.subarray(offset[i], offset[i] + size[i]);
    return readLists(this.engine, bytes, crc[i], component[i], header.shDegree, counts);
  }
}
