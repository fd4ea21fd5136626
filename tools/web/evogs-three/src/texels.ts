/** What changed in a scene, as rows of textures. It imports no renderer, so that it can run in a worker. */

import { CORE, type Change, PICKS, type Scene, ShownChannels, channelsOf, groupOf, slotFloats } from "evogs";
import { type Layout, SOURCES, TEXELS, layoutOf } from "./layout.js";
import { Halves, half, lnScale, packRotation } from "./pack.js";

export { type Layout, SOURCES, TEXELS, layoutOf } from "./layout.js";

/** New texels of a texture: of `columns` splats from `column` on, in `rows` rows from `row` on. */
export interface TexelUpdate {
  /** 0 for core, the SH band, or `SOURCES`. */
  texture: number;
  column: number;
  row: number;
  columns: number;
  rows: number;
  /** Four words for each texel; of `SOURCES` one. */
  data: Uint32Array;
}

/** sqrt(1 / (4 pi)), of SH band 0. */
const C0 = 0.28209479177387814;
const N_CORE = 14;

/** Turns changes of a scene into texels. Rows are given to tiles as their slots come. */
export class TexelWriter {
  /** Rows that tiles have: so many hold splats, from 0 on. */
  usedRows = 0;
  /** The rows of each tile, in the order of its slots. */
  private readonly rowsOf: number[][] = [];
  /** Slots of each tile that were written. */
  private readonly written: number[] = [];
  private readonly shown: ShownChannels;
  private readonly halves: Halves;
  private floats: Float32Array[] = [];
  /** Texels of the entries of the palette so far, for each SH band. */
  private readonly entries: { count: number; texels: Uint32Array }[] = [];

  constructor(
    private readonly scene: Scene,
    readonly layout: Layout = layoutOf(scene.directory),
  ) {
    this.shown = new ShownChannels(scene);
    this.halves = new Halves(2 ** -scene.directory.header.gridExponents[groupOf(N_CORE)]);
  }

  /** Splats to draw: those of the rows that are used. Places without a splat are transparent. */
  get count(): number {
    return this.usedRows * this.layout.width;
  }

  /** Texels of what `Decoder.takeChanges` gave. Second children are told from where they grow. */
  write(changes: readonly Change[]): TexelUpdate[] {
    this.shown.reset();
    const updates: TexelUpdate[] = [];
    for (const { tile, component, ranges } of changes) {
      this.reserve(tile);
      const { nSlots } = this.scene.tile(tile);
      if (component === CORE) this.writeSources(tile, updates);
      for (const { start, count } of ranges) {
        const end = Math.min(start + count, nSlots);
        if (component === PICKS) {
          for (let band = 1; band <= this.layout.shDegree; band++)
            this.writeSlots(tile, band, start, end, updates);
        } else {
          this.writeSlots(tile, component, start, end, updates);
        }
      }
    }
    return updates;
  }

  /** Texels of all that is there, for textures that are new. */
  writeAll(): TexelUpdate[] {
    const changes: Change[] = [];
    for (let tile = 0; tile < this.scene.directory.header.nTiles; tile++) {
      const ranges = [{ start: 0, count: this.scene.tile(tile).nSlots }];
      for (let component = 0; component <= this.layout.shDegree && ranges[0].count > 0; component++) {
        changes.push({ tile, component, ranges });
      }
    }
    return this.write(changes);
  }

  private reserve(tile: number): void {
    const rows = this.rowsOf[tile] ?? [];
    this.rowsOf[tile] = rows;
    const need = Math.ceil(this.scene.tile(tile).nSlots / this.layout.width);
    while (rows.length < need) rows.push(this.usedRows++);
  }

  /** Of slots that were not written yet: 1 + the place of the ancestor that was, or 0 without one. */
  private writeSources(tile: number, updates: TexelUpdate[]): void {
    const { nSlots, bornFrom } = this.scene.tile(tile);
    const had = this.written[tile] ?? 0;
    this.written[tile] = nSlots;
    if (had === 0 || had === nSlots) return;
    const ancestors = new Int32Array(nSlots - had);
    for (let u = had; u < nSlots; u++) {
      const parent = bornFrom[u];
      ancestors[u - had] = parent < had ? parent : ancestors[parent - had];
    }
    const { width } = this.layout;
    const rowsOf = this.rowsOf[tile];
    this.cut(tile, had, nSlots, (s, n, column, row, rows) => {
      const data = Uint32Array.from({ length: n }, (_, i) => {
        const u = ancestors[s - had + i];
        return u < 0 ? 0 : 1 + rowsOf[Math.floor(u / width)] * width + (u % width);
      });
      updates.push({ texture: SOURCES, column, row, columns: n / rows, rows, data });
    });
  }

  private writeSlots(tile: number, component: number, start: number, end: number, updates: TexelUpdate[]): void {
    this.cut(tile, start, end, (s, n, column, row, rows) => {
      const data = component === CORE ? this.coreTexels(tile, s, n) : this.bandTexels(tile, component, s, n);
      updates.push({ texture: component, column, row, columns: n / rows, rows, data });
    });
  }

  /** Cuts a range of slots where its rows are not neighbours: whole rows go together. */
  private cut(
    tile: number,
    start: number,
    end: number,
    take: (from: number, n: number, column: number, row: number, rows: number) => void,
  ): void {
    const { width } = this.layout;
    const rowsOf = this.rowsOf[tile];
    for (let s = start; s < end; ) {
      const column = s % width;
      const first = Math.floor(s / width);
      let rows = 1;
      let n = Math.min(width - column, end - s);
      if (column === 0 && n === width) {
        while ((rows + 1) * width <= end - s && rowsOf[first + rows] === rowsOf[first] + rows) rows++;
        n = rows * width;
      }
      take(s, n, column, rowsOf[first], rows);
      s += n;
    }
  }

  private channels(tile: number, first: number, count: number, start: number, n: number): Float32Array[] {
    if ((this.floats[0]?.length ?? 0) < n) this.floats = [];
    while (this.floats.length < count)
      this.floats.push(new Float32Array(Math.max(n, this.floats[0]?.length ?? 1024)));
    for (let k = 0; k < count; k++) {
      slotFloats(this.scene, tile, first + k, start, start + n, this.floats[k], this.shown);
    }
    return this.floats;
  }

  /** Position; opacity and scales; rotation; colour of SH band 0. Dead slots have opacity 0. */
  private coreTexels(tile: number, start: number, n: number): Uint32Array {
    const words = 4 * TEXELS[0];
    const out = new Uint32Array(words * n);
    const floats = new Float32Array(out.buffer);
    const live = this.scene.tile(tile).liveSlots();
    const c = this.channels(tile, 0, N_CORE, start, n);
    for (let u = 0; u < n; u++) {
      if (live[start + u] === 0) continue;
      const at = words * u;
      for (let axis = 0; axis < 3; axis++) floats[at + axis] = c[axis][u];
      out[at + 3] = half(1 / (1 + Math.exp(-c[10][u]))) | (lnScale(c[7][u]) << 16);
      out[at + 4] = lnScale(c[8][u]) | (lnScale(c[9][u]) << 16);
      packRotation(c[3][u], c[4][u], c[5][u], c[6][u], out, at + 5);
      out[at + 6] |= half(0.5 + C0 * c[11][u]) << 16;
      out[at + 7] = half(0.5 + C0 * c[12][u]) | (half(0.5 + C0 * c[13][u]) << 16);
    }
    return out;
  }

  /** The coefficients of an SH band, two in a word: red, green and blue of each function. */
  private bandTexels(tile: number, band: number, start: number, n: number): Uint32Array {
    if (this.scene.directory.header.hasPalette) return this.pickedTexels(tile, band, start, n);
    const { first, count } = channelsOf(band, this.layout.shDegree);
    const channels = Array.from({ length: count }, (_, k) => this.shown.read(tile, first + k, start, start + n));
    return packBand(band, channels, n, this.halves);
  }

  /** As `bandTexels`: texels of entries, which never change. */
  private pickedTexels(tile: number, band: number, start: number, n: number): Uint32Array {
    const words = 4 * TEXELS[band];
    const entries = this.entryTexels(band);
    const picks = this.shown.readPicks(tile, start, start + n);
    const out = new Uint32Array(words * n);
    for (let u = 0, at = 0; u < n; u++, at += words) {
      const from = words * (picks[u] - 1);
      if (from >= 0) for (let word = 0; word < words; word++) out[at + word] = entries[from + word];
    }
    return out;
  }

  /** Texels of a band of all entries of the palette; those that came before are kept. */
  private entryTexels(band: number): Uint32Array {
    const { palette } = this.scene;
    const words = 4 * TEXELS[band];
    const { count: had, texels: old } = this.entries[band] ?? { count: 0, texels: new Uint32Array(0) };
    if (had === palette.count) return old;
    const { first, count } = channelsOf(band, this.layout.shDegree);
    const channels = Array.from({ length: count }, (_, k) => palette.channel(first - N_CORE + k).subarray(had));
    const texels = new Uint32Array(words * palette.count);
    texels.set(old);
    texels.set(packBand(band, channels, palette.count - had, this.halves), words * had);
    this.entries[band] = { count: palette.count, texels };
    return texels;
  }
}

/** Texels of `n` splats, of the integers of the channels of an SH band. */
function packBand(band: number, channels: readonly Int32Array[], n: number, halves: Halves): Uint32Array {
  const words = 4 * TEXELS[band];
  const out = new Uint32Array(words * n);
  const none = new Int32Array(n);
  for (let k = 0; k < channels.length; k += 2) {
    const low = channels[k];
    const high = channels[k + 1] ?? none;
    for (let u = 0, at = k >> 1; u < n; u++, at += words) out[at] = halves.of(low[u]) | (halves.of(high[u]) << 16);
  }
  return out;
}
