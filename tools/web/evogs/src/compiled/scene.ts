/** A scene by the engine: its numbers are copied out of its memory. */

import { CORE, PICKS } from "../model.js";
import type { Scene } from "../scene.js";
import type { TileState } from "../tileState.js";
import type { Engine } from "./engine.js";
import type { Sink } from "./tile.js";

export class SceneSink implements Sink {
  private tile: TileState;

  constructor(
    private readonly engine: Engine,
    private readonly scene: Scene,
  ) {
    this.tile = scene.tile(0);
  }

  palette(data: number, n: number): void {
    const { palette } = this.scene;
    palette.take(this.engine.at(data, palette.nChannels * n).slice(), n);
  }

  slots(t: number, live: number, n: number, bornFrom: number): void {
    this.tile = this.scene.newTile(t);
    this.tile.nSlots = n;
    this.tile.live = this.engine.bytes.slice(live, live + n);
    this.tile.bornFrom = this.engine.at(bornFrom, n).slice();
    this.scene.setTile(t, this.tile);
  }

  component(component: number, data: number, n: number, steps: number): void {
    const { engine, tile } = this;
    tile.steps[component] = steps;
    if (component === PICKS) {
      tile.picks = engine.at(data, n).slice();
      tile.nPicks = n;
      return;
    }
    const block = component === CORE ? tile.core : tile.block(component);
    block.take(engine.at(data, block.nChannels * n).slice(), n);
  }
}
