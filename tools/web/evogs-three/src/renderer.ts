/** What a viewer needs of a renderer: little enough that another one can take its place. */

import type { Layout, TexelUpdate } from "./texels.js";

export interface CameraPose {
  eye: readonly [number, number, number];
  /** Rows of the rotation from the world to the camera: right, up and backward, of length 1. */
  rotation: readonly (readonly [number, number, number])[];
  /** The vertical angle of view, in radians. */
  fovY: number;
  near: number;
  far: number;
}

export interface SplatRenderer {
  readonly canvas: HTMLCanvasElement;
  /** Called when there is a reason to draw again, such as a new order of the splats. */
  onDirty: () => void;
  /** Called when the GPU lost all textures, and has new ones: everything must be written again. */
  onLost: () => void;
  /** Called when the GPU lost all that it had, with `true`, and when it can draw again, with `false`. */
  onContext?: (isLost: boolean) => void;
  /** Columns and rows that a texture may have. */
  readonly maxTextureSize: number;
  /** Makes room for a scene, and forgets the one before. */
  open(layout: Layout): void;
  /**
   * Writes texels; `count` splats are drawn from now on. For so many seconds they move from their states before to
   * those after, if the scene is not too large for it. What still moved is at its end then.
   */
  update(updates: readonly TexelUpdate[], count: number, seconds?: number): void;
  /** Forgets the scene before; the next one comes in parts, as files of a tileset do. */
  openParts(): void;
  /** Makes room for a part at a place, or anew for one that is there. It is drawn when `showParts` says so. */
  openPart(part: number, layout: Layout, at: readonly [number, number, number]): void;
  /** Writes texels of a part. Its splats do not move to their new states. */
  updatePart(part: number, updates: readonly TexelUpdate[], count: number): void;
  /** Draws these parts and no others, and forgets those that are not kept. */
  showParts(shown: readonly number[], kept: readonly number[]): void;
  setShDegree(degree: number): void;
  resize(width: number, height: number, pixelRatio: number): void;
  draw(pose: CameraPose): void;
  /** Whether splats are on their way: draw again. */
  readonly isMoving: boolean;
  /** Whether the picture is that of the last camera and the last texels: sorting takes some time. */
  readonly isSettled: boolean;
  /** Ends it with its workers, and frees the GPU. The canvas cannot be drawn in again: make another one. */
  dispose(): void;
}
