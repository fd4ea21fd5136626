/** Channels, classes, groups and components (spec 3.1, 3.2, 3.5). */

/** Components: the parts of a step that are sent apart. SH band b is component b. */
export const CORE = 0;
export const PICKS = 4;
export const PALETTE = 5;
export const N_COMPONENTS = 6;

/** Channels 0 .. 13 belong to core: all up to SH band 0. */
export const N_CORE = 14;
/** The first SH channel. */
export const FIRST_SH = 11;

/** Kinds of records (spec 3.3). */
export const REFINE = 0;
export const SPLIT = 1;
export const DROP = 2;

const GROUPS = [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3];

/** The group of a channel: 0 position, 1 rotation, 2 scale, 3 opacity, 4 SH. */
export function groupOf(channel: number): number {
  return channel < FIRST_SH ? GROUPS[channel] : 4;
}

/** The class of a channel. Channels of a class share a quantiser. */
export function classOf(channel: number): number {
  if (channel < FIRST_SH) return GROUPS[channel];
  return 4 + Math.floor(Math.sqrt(Math.floor((channel - FIRST_SH) / 3)));
}

/** D, the number of channels of a splat. */
export function channelCount(shDegree: number): number {
  return FIRST_SH + 3 * (shDegree + 1) ** 2;
}

/** The first channel of a component, and how many it has. Picks and palette have all from 14 on. */
export function channelsOf(component: number, shDegree: number): { first: number; count: number } {
  if (component === CORE) return { first: 0, count: N_CORE };
  if (component < PICKS) return { first: FIRST_SH + 3 * component ** 2, count: 3 * (2 * component + 1) };
  return { first: N_CORE, count: channelCount(shDegree) - N_CORE };
}

/** Whether a stream has a component (the table of 3.5). */
export function hasComponent(component: number, shDegree: number, hasPalette: boolean): boolean {
  if (component === CORE) return true;
  if (component === PICKS || component === PALETTE) return hasPalette;
  return !hasPalette && component <= shDegree;
}
