/** What the page and its worker say to each other. */

import type { Viewpoint } from "evogs";
import type { FetchFailure, FetchState } from "evogs-fetch";
import type { Layout, TexelUpdate } from "evogs-three/texels";

/** What is wanted of a scene. */
export interface Wants {
  /** Live splats at most. Infinity for all. */
  splats: number;
  shDegree: number;
  bytesPerSecond: number;
  isPaused: boolean;
}

export interface EyeAndPlanes {
  eye: [number, number, number];
  planes: [number, number, number, number][];
  /** Pixels of something of size 1 at distance 1. */
  pixels: number;
}

export type ToWorker =
  | { kind: "open"; source: string | File; wants: Wants; maxTextureSize: number }
  | { kind: "want"; wants: Wants }
  | { kind: "view"; view: EyeAndPlanes }
  | { kind: "retry" }
  /** Shows what the first `bytes` that came gave, or all that came. */
  | { kind: "scrub"; bytes: number | null }
  /** The page can take more texels. */
  | { kind: "drawn" }
  /** All texels again. */
  | { kind: "rewrite" };

/** What the header and the metadata say. */
export interface SceneInfo {
  name: string;
  size: number;
  splats: number;
  levels: number;
  tiles: number;
  shDegree: number;
  up: [number, number, number] | null;
  /** The default camera. */
  camera: Viewpoint | null;
  title: string;
  /** Whether the timeline can show what had arrived. */
  canLookBack: boolean;
}

export interface Progress {
  /** Bytes that what is shown has; less than `fetched` where one looks back. */
  received: number;
  fetched: number;
  size: number | null;
  requests: number;
  state: FetchState;
  isPaused: boolean;
  /** All that is wanted is there. */
  isDone: boolean;
  /** Why bytes are waited for, in words, until some come. */
  waitsFor: string;
  splats: number;
  packets: number;
  packetsApplied: number;
  /** The highest level of which all core packets are there, or -1. */
  level: number;
  digests: { rows: number; checked: number; wrong: number } | null;
  /** The first faulty packet, in words. */
  fault: string;
  /** Of a tileset: the files that are drawn. */
  files?: string[];
  /** Of a tileset: files that cannot be read, though they are wanted. The others go on. */
  failedFiles?: { name: string; message: string }[];
}

export type FromWorker =
  /** Without a layout the scene comes in parts. */
  | { kind: "opened"; info: SceneInfo; layout: Layout | null }
  | {
      kind: "part";
      part: number;
      at: [number, number, number];
      updates: TexelUpdate[];
      count: number;
      isFresh: boolean;
      layout: Layout;
    }
  /** Which parts are drawn, and which are to be kept. */
  | { kind: "parts"; shown: number[]; kept: number[] }
  /** Where the splats are, as far as they came: a middle and a distance that holds most of them. */
  | { kind: "bounds"; middle: [number, number, number]; radius: number }
  | { kind: "texels"; updates: TexelUpdate[]; count: number; isFresh: boolean; layout: Layout }
  | { kind: "progress"; progress: Progress }
  | { kind: "failed"; failure: FetchFailure | "internal"; message: string };
