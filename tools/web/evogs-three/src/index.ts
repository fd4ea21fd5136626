/** Drawing EvoGS scenes while they arrive. */

export type { CameraPose, SplatRenderer } from "./renderer.js";
export { SparkSplats } from "./spark.js";
export { type Layout, type TexelUpdate, TexelWriter, layoutOf } from "./texels.js";
