/**
 * All packets of a tile, or of the palette, at once (spec 7, 12.5), in the memory of the engine. It names no fault:
 * a StreamError or NotCompiled says that the plain code has to decode the file.
 */

import type { ChannelBlock } from "../channelBlock.js";
import type { Directory } from "../directory.js";
import { PICKS_OF_CHANGED, type StepCounts } from "../lists.js";
import { CORE, N_COMPONENTS, PALETTE, PICKS, channelsOf } from "../model.js";
import type { Scene } from "../scene.js";
import type { Box } from "../step.js";
import type { TileState } from "../tileState.js";
import { ChannelRun, type Step } from "./channels.js";
import { type Engine, need } from "./engine.js";
import { type Lists, readLists, storedOf } from "./lists.js";
import { type Records, findSiblings, noRecords, readRecords } from "./records.js";

const NO_PARENT = -1;

/** Decodes a whole file to a new scene. It throws where that cannot be. */
export function decodeAll(engine: Engine, file: Uint8Array, scene: Scene): void {
  const { directory, cut, palette } = scene;
  const { first, next, label } = directory.packets;
  const chainFrom = (chain: number): number[] => {
    const packets: number[] = [];
    for (let i = first[chain] ?? -1; i >= 0 && label[i] <= cut.level; i = next[i]) packets.push(i);
    return packets;
  };
  const tiles = new CompiledTiles(engine, file, directory);
  tiles.decodePalette(chainFrom(PALETTE), palette);
  for (let t = 0; t < directory.header.nTiles; t++) {
    const chains = [0, 1, 2, 3, 4].map((component) => chainFrom(t * N_COMPONENTS + component));
    if (chains[CORE].length === 0) continue;
    const tile = scene.newTile(t);
    tiles.decodeTile(tile, chains, scene.boxOf(t), cut.entriesUpTo);
    scene.setTile(t, tile);
  }
}

class CompiledTiles {
  constructor(
    private readonly engine: Engine,
    private readonly file: Uint8Array,
    private readonly directory: Directory,
  ) {}

  /** The entries of the palette, by the packets of its chain. */
  decodePalette(chain: number[], palette: ChannelBlock): void {
    const { engine } = this;
    const mark = engine.mark();
    let n = 0;
    const steps = chain.map((i) => {
      const counts = this.countsOf(i);
      const step = { records: noRecords(0, counts), lists: this.readLists(i, counts), from: n };
      n += counts.nAdds;
      return step;
    });
    this.channels(PALETTE, steps, n, null).run(palette);
    engine.release(mark);
  }

  /** A new tile, by the chains of its components 0 to 4. `nEntries` has the entries of the palette by label. */
  decodeTile(tile: TileState, chains: number[][], box: Box, nEntries: Uint32Array): void {
    const { engine } = this;
    const mark = engine.mark();
    const live = engine.take(tile.plan.mostSlots);
    const bornFrom = engine.takeIntegers(tile.plan.mostSlots);
    const places = engine.takeIntegers(tile.plan.mostSlots);
    const records = new Map<number, Records>();
    let n = 0;
    const steps = chains[CORE].map((i) => {
      const step = this.readStep(i, live, bornFrom, places, n);
      records.set(i, step.records);
      n += step.records.nSplits + step.records.nAdds;
      return step;
    });
    tile.nSlots = n;
    tile.live = engine.bytes.slice(live, live + n);
    tile.bornFrom = engine.at(bornFrom, n).slice();
    this.channels(CORE, steps, n, box).run(tile.core);
    tile.steps[CORE] = steps.length;
    for (let component = 1; component <= PICKS; component++) {
      const inner = engine.mark();
      this.decodeBand(tile, component, chains[component], records, nEntries);
      engine.release(inner);
    }
    engine.release(mark);
  }

  /** An SH band, or picks. */
  private decodeBand(
    tile: TileState,
    component: number,
    chain: number[],
    recordsOf: Map<number, Records>,
    nEntries: Uint32Array,
  ): void {
    if (chain.length === 0) return;
    let n = 0;
    const steps = chain.map((i) => {
      const records = recordsOf.get(this.directory.packets.core[i]) as Records;
      const step = { records, lists: this.readLists(i, records), from: n };
      n += records.nSplits + records.nAdds;
      return step;
    });
    tile.steps[component] = steps.length;
    if (component === PICKS) {
      this.decodePicks(tile, steps, n, nEntries);
      return;
    }
    this.channels(component, steps, n, null).run(tile.block(component));
  }

  private decodePicks(tile: TileState, steps: Step[], n: number, nEntries: Uint32Array): void {
    const { engine } = this;
    const { kernels } = engine;
    const x = engine.takeIntegers(n);
    for (const { lists, records, from } of steps) {
      const { nPsi, psi, nSplits, parents, nAdds, nDrops, drops, label } = records;
      const nNew = nSplits + nAdds;
      const fresh = x + 4 * from;
      if (lists === null) {
        const all = engine.at(x, from + nNew);
        const born = engine.at(parents, nSplits);
        for (let j = 0; j < nSplits; j++) all[from + j] = all[born[j]];
        all.fill(0, from + nSplits);
      } else {
        const nChanged = (lists.flags & PICKS_OF_CHANGED) !== 0 ? nPsi : 0;
        const picks = storedOf(engine, lists, lists.layout.picks);
        need(kernels.areAtMost(picks, nChanged + nNew, nEntries[label]));
        kernels.setSlots(x, psi, nChanged, picks);
        engine.at(fresh, nNew).set(engine.at(picks + 4 * nChanged, nNew));
      }
      kernels.clearSlots(x, drops, nDrops);
    }
    tile.picks = engine.at(x, n).slice();
    tile.nPicks = n;
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

  private channels(component: number, steps: Step[], n: number, box: Box | null): ChannelRun {
    const { header, quantisers } = this.directory;
    const { first } = channelsOf(component, header.shDegree);
    return new ChannelRun(this.engine, quantisers, first, steps, n, box);
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
