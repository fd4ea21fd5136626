/** What an address of the page says of the view. */

import type { Vec } from "./vectors.js";

export interface Link {
  /** As `Camera.text` writes it. */
  view: string;
  up: Vec | null;
}

const AXIS = /^(-?)([xyz])$/;

export function linkOf({ search, hash }: { search: string; hash: string }): Link {
  const view = new URLSearchParams(hash.slice(1)).get("view") ?? "";
  return { view, up: upOf(new URLSearchParams(search).get("up") ?? "") };
}

/** A direction as addresses name it: an axis, such as `-y`, or three numbers. Null if it is none. */
export function upOf(text: string): Vec | null {
  const axis = AXIS.exec(text);
  const numbers =
    axis === null
      ? text.split(",").map(Number)
      : ["x", "y", "z"].map((name) => (name !== axis[2] ? 0 : axis[1] === "-" ? -1 : 1));
  const [x, y, z] = numbers;
  return numbers.length === 3 && numbers.every(Number.isFinite) && Math.hypot(x, y, z) > 0 ? [x, y, z] : null;
}

export function upText(up: Vec): string {
  const size = Math.hypot(...up);
  const axis = up.findIndex((x) => Math.abs(x) === size);
  if (axis >= 0) return `${up[axis] < 0 ? "-" : ""}${"xyz"[axis]}`;
  return up.map((x) => Number((x / size).toPrecision(6))).join(",");
}
