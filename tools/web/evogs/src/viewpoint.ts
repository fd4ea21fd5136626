/** The default camera of a stream (spec 8.4, the metadata key `camera`). A malformed one is none. */

const MOST = 1e30;

type Triple = [number, number, number];

export interface Viewpoint {
  position: Triple;
  /** In the middle of the picture. */
  target: Triple;
  /** Up in the picture; null: the up axis of the header. */
  up: Triple | null;
  /** The vertical field of view, degrees. */
  fovY: number;
}

/** The default camera that metadata name, in the coordinates of the stream; null without one. */
export function viewpointOf(metadata: ReadonlyMap<string, string>): Viewpoint | null {
  const found = parsed(metadata.get("camera") ?? "");
  if (typeof found !== "object" || found === null || Array.isArray(found)) return null;
  const members = found as Record<string, unknown>;
  const [position, target] = [triple(members.position), triple(members.target)];
  const up = triple(members.up);
  const fovY = members.fov_y;
  if (position === null || target === null || (up === null && "up" in members)) return null;
  if (!isNumber(fovY) || fovY <= 0 || fovY >= 180) return null;
  const ahead = target.map((x, axis) => x - position[axis]) as Triple;
  if (Math.hypot(...ahead) === 0) return null;
  if (up !== null && !(Math.hypot(...cross(ahead, up)) > 1e-6 * Math.hypot(...ahead) * Math.hypot(...up)))
    return null;
  return { position, target, up, fovY };
}

function parsed(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

function isNumber(value: unknown): value is number {
  return typeof value === "number" && Math.abs(value) <= MOST;
}

function triple(value: unknown): Triple | null {
  return Array.isArray(value) && value.length === 3 && value.every(isNumber) ? (value as Triple) : null;
}

function cross(a: Triple, b: Triple): Triple {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}
