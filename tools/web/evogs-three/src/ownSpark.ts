/** Spark as it is used here: its slopes are bounded, its sorts may fail, and its end leaves no worker. */

import { SparkRenderer, type SparkRendererOptions } from "@sparkjsdev/spark";

/** What sorts the splats, if they need it. The types of Spark hide it. */
interface Sorter {
  driveSort: () => Promise<void>;
}

export class OwnSpark extends SparkRenderer {
  private isOver = false;

  /** Throws an Error if it is another version of Spark. */
  constructor(options: SparkRendererOptions) {
    super(options);
    boundSlopes(this);
    const sorter = this as unknown as Sorter;
    const sort = sorter.driveSort;
    if (typeof sort !== "function") throw new Error("the sorts of this version of Spark are not known");
    sorter.driveSort = async () => {
      if (this.isOver) return;
      try {
        await sort.call(this);
      } catch (error) {
        // Its context was lost. Spark would wait for this sort for ever.
        this.sorting = false;
        if (!this.isOver && !this.renderer.getContext().isContextLost()) throw error;
      }
    };
  }

  /** Ends its worker too, also while it sorts. */
  override dispose(): void {
    this.isOver = true;
    this.onDirty = undefined;
    clearTimeout(this.sortTimeoutId);
    super.dispose();
    this.geometry.dispose();
    this.material.dispose();
  }
}

/**
 * Bounds the slopes at which the projection is linearised to 1.3 times those of the picture (spec/rasterizer.md):
 * without it, splats far aside smear over the whole picture. Spark offers no option for it.
 */
function boundSlopes(spark: SparkRenderer): void {
  const { material } = spark;
  const plain = "vec2 J2 = -(J1 * viewCenter.xy) * invZ;";
  if (!material.vertexShader.includes(plain)) throw new Error("the shader of this version of Spark is not known");
  const bounded = `
    vec2 widest = 1.3 / vec2(projectionMatrix[0][0], projectionMatrix[1][1]);
    vec2 J2 = -J1 * clamp(viewCenter.xy * invZ, -widest, widest);`;
  material.vertexShader = material.vertexShader.replace(plain, bounded);
}
