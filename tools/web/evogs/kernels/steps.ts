/** What a step does to the numbers of a tile (spec 7.2, 7.3). All integers have 4 bytes, unless said. */

const SPLIT: i32 = 1;
const DROP: i32 = 2;
const NONE: i32 = -1;
/** Bytes of a run. */
const RUN: usize = 12;

/** Slots of records from gaps. False if one is not below `nSlots`, or not live: a byte for each slot. */
export function readSlots(gaps: usize, n: usize, live: usize, nSlots: u32, slots: usize): bool {
  let slot: u32 = NONE;
  for (let i: usize = 0; i < n; i++) {
    // A gap is below 2^24, so the sum stays small.
    slot += load<u32>(gaps + (i << 2)) + 1;
    if (slot >= nSlots || load<u8>(live + slot) !== 1) return false;
    store<u32>(slots + (i << 2), slot);
  }
  return true;
}

/**
 * Sorts records by what they do: slots of refines and splits, places of splits among them and their slots, and
 * slots of drops. Each list has room for one more. False unless there are as many of each kind.
 */
export function sortRecords(
  kinds: usize,
  slots: usize,
  n: usize,
  psi: usize,
  splits: usize,
  parents: usize,
  drops: usize,
  nPsi: u32,
  nSplits: u32,
  nDrops: u32,
): bool {
  let i: u32 = 0;
  let j: u32 = 0;
  let k: u32 = 0;
  // No branch, since what a record does cannot be foreseen: each is written to all lists, and only one grows.
  for (let r: usize = 0; r < n; r++) {
    const slot = load<i32>(slots + (r << 2));
    const kind = load<i32>(kinds + (r << 2));
    if (<u32>kind > <u32>DROP || i > nPsi || j > nSplits || k > nDrops) return false;
    store<i32>(psi + (i << 2), slot);
    store<i32>(parents + (j << 2), slot);
    store<i32>(splits + (j << 2), i);
    store<i32>(drops + (k << 2), slot);
    i += i32(kind !== DROP);
    j += i32(kind === SPLIT);
    k += i32(kind === DROP);
  }
  return i === nPsi && j === nSplits && k === nDrops;
}

/**
 * Runs of `n` pairs of integers that both grow by one: the first pair, and how many there are, as three integers.
 * Without `places`, the first integer of a pair is its number. The number of runs.
 */
export function runsOf(places: usize, slots: usize, n: usize, runs: usize): i32 {
  let at = runs - RUN;
  let place: i32 = 0;
  let slot: i32 = NONE;
  for (let i: usize = 0; i < n; i++) {
    const nextPlace = places === 0 ? <i32>i : load<i32>(places + (i << 2));
    const nextSlot = load<i32>(slots + (i << 2));
    if (slot < 0 || nextPlace !== place + 1 || nextSlot !== slot + 1) {
      at += RUN;
      store<i32>(at, nextPlace, 0);
      store<i32>(at, nextSlot, 4);
      store<i32>(at, 0, 8);
    }
    store<i32>(at, load<i32>(at, 8) + 1, 8);
    place = nextPlace;
    slot = nextSlot;
  }
  return <i32>((at + RUN - runs) / RUN);
}

/** The values of table entries, 2 bytes each. `indices` are those of the entries, or 0 if all are 0. */
export function valuesOf(entries: usize, indices: usize, n: usize, out: usize): void {
  for (let i: usize = 0; i < n << 2; i += 4) {
    const index: usize = indices === 0 ? 0 : load<i32>(indices + i);
    store<i32>(out + i, load<i16>(entries + (index << 1)));
  }
}

/**
 * Pairs of places, of each record and of that whose slot it was born from, where there is one: in runs, as `runsOf`
 * writes them, of at most `longest`. Slots increase, so that record is an earlier one. No record of a run is in it
 * twice.
 * `places` has room for as many integers as there are slots, and holds anything. `growth` has room for `n`.
 * Behind the runs stands how many differences are added to one integer at most, and one.
 */
export function siblingsOf(
  slots: usize,
  n: i32,
  bornFrom: usize,
  places: usize,
  growth: usize,
  longest: i32,
  runs: usize,
): i32 {
  let at = runs - RUN;
  let first = 0;
  let lastPlace = NONE;
  let last = NONE;
  let most = 1;
  for (let i = 0; i < n; i++) {
    const slot = load<i32>(slots + 4 * i);
    const parent = load<i32>(bornFrom + 4 * slot);
    const place = parent < 0 ? NONE : load<i32>(places + 4 * parent);
    store<i32>(places + 4 * slot, i);
    store<i32>(growth + 4 * i, 1);
    if (place < 0 || place >= i || load<i32>(slots + 4 * place) !== parent) continue;
    if (last < 0 || i !== last + 1 || place !== lastPlace + 1 || place >= first || load<i32>(at, 8) >= longest) {
      at += RUN;
      store<i32>(at, i, 0);
      store<i32>(at, place, 4);
      store<i32>(at, 0, 8);
      first = i;
    }
    store<i32>(at, load<i32>(at, 8) + 1, 8);
    last = i;
    lastPlace = place;
    const sums = load<i32>(growth + 4 * place) + 1;
    store<i32>(growth + 4 * place, sums);
    store<i32>(growth + 4 * i, sums);
    most = max(most, sums);
  }
  store<i32>(at + RUN, most);
  return <i32>((at + RUN - runs) / RUN);
}

// Loops over runs take four integers at a time. Behind the end of a run they write what was there.

/** The first `n` of four places. */
function lanes(n: usize): v128 {
  return i32x4.lt_s(i32x4(0, 1, 2, 3), i32x4.splat(<i32>n));
}

/** Writes those of four integers that the mask names. */
function storeLanes(at: usize, four: v128, mask: v128): void {
  v128.store(at, v128.bitselect(four, v128.load(at), mask));
}

/** The integers of a list of sibling differences, in place. */
export function addSiblings(values: usize, runs: usize, n: usize): void {
  for (let run = runs; run < runs + n * RUN; run += RUN) {
    let at = values + (load<u32>(run, 0) << 2);
    let to = values + (load<u32>(run, 4) << 2);
    for (let left: isize = load<i32>(run, 8); left > 0; left -= 4) {
      const mask = lanes(left);
      const difference = v128.load(at);
      const before = v128.load(to);
      storeLanes(at, i32x4.sub(before, difference), mask);
      // Read once more: what was just written may stand behind the end of the run.
      storeLanes(to, i32x4.add(before, difference), mask);
      at += 16;
      to += 16;
    }
  }
}

/** As `addSiblings`, for runs of one. */
export function addSiblingsEach(values: usize, runs: usize, n: usize): void {
  for (let run = runs; run < runs + n * RUN; run += RUN) {
    const at = values + (load<i32>(run, 0) << 2);
    const to = values + (load<i32>(run, 4) << 2);
    const difference = load<i32>(at);
    const before = load<i32>(to);
    store<i32>(at, before - difference);
    store<i32>(to, before + difference);
  }
}

/** As `addDelta`, for slots without runs. */
export function addDeltaEach(x: usize, slots: usize, n: usize, delta: usize, least: i32, most: i32): bool {
  let wrong: i32 = 0;
  for (let i: usize = 0; i < n << 2; i += 4) {
    const at = x + (load<i32>(slots + i) << 2);
    const sum = load<i32>(at) + load<i32>(delta + i);
    wrong |= i32(sum < least) | i32(sum > most);
    store<i32>(at, sum);
  }
  return wrong === 0;
}

/** Adds Delta to the numbers of slots, whose runs are given. Whether all are within least .. most then. */
export function addDelta(x: usize, runs: usize, n: usize, delta: usize, least: i32, most: i32): bool {
  const low = i32x4.splat(least);
  const high = i32x4.splat(most);
  let wrong = i32x4.splat(0);
  for (let run = runs; run < runs + n * RUN; run += RUN) {
    let from = delta + (load<u32>(run, 0) << 2);
    let at = x + (load<u32>(run, 4) << 2);
    for (let left: isize = load<i32>(run, 8); left > 0; left -= 4) {
      const mask = lanes(left);
      const sum = i32x4.add(v128.load(at), v128.load(from));
      wrong = v128.or(wrong, v128.and(mask, v128.or(i32x4.lt_s(sum, low), i32x4.gt_s(sum, high))));
      storeLanes(at, sum, mask);
      at += 16;
      from += 16;
    }
  }
  return !v128.any_true(wrong);
}

/** Whether `n` numbers are within least .. most. */
export function areWithin(x: usize, n: usize, least: i32, most: i32): bool {
  const low = i32x4.splat(least);
  const high = i32x4.splat(most);
  let wrong = i32x4.splat(0);
  for (let i: usize = 0; i < n; i += 4) {
    const four = v128.load(x + (i << 2));
    wrong = v128.or(wrong, v128.and(lanes(n - i), v128.or(i32x4.lt_s(four, low), i32x4.gt_s(four, high))));
  }
  return !v128.any_true(wrong);
}

/**
 * Second children P - round(alpha * Delta) of splits, from P before the step, to `out`. Runs have the places in Delta
 * and the slots of P, and `alpha` a number for each split. Whether all are within least .. most.
 */
export function writeSeconds(
  x: usize,
  out: usize,
  runs: usize,
  n: usize,
  delta: usize,
  alpha: usize,
  shift: i32,
  least: i32,
  most: i32,
): bool {
  let done: usize = 0;
  const half = i32x4.splat((1 << shift) >> 1);
  const low = i32x4.splat(least);
  const high = i32x4.splat(most);
  let wrong = i32x4.splat(0);
  for (let run = runs; run < runs + n * RUN; run += RUN) {
    const from = delta + (load<u32>(run, 0) << 2);
    const at = x + (load<u32>(run, 4) << 2);
    const count: isize = load<i32>(run, 8);
    for (let k: isize = 0; k < count << 2; k += 16) {
      const mask = lanes(count - (k >> 2));
      const product = i32x4.mul(v128.load(from + k), v128.load(alpha + done + k));
      const second = i32x4.sub(v128.load(at + k), i32x4.shr_s(i32x4.add(product, half), shift));
      wrong = v128.or(wrong, v128.and(mask, v128.or(i32x4.lt_s(second, low), i32x4.gt_s(second, high))));
      storeLanes(out + done + k, second, mask);
    }
    done += count << 2;
  }
  return !v128.any_true(wrong);
}

/** Writes a number to slots. */
export function setSlots(x: usize, slots: usize, n: usize, numbers: usize): void {
  for (let i: usize = 0; i < n; i++) {
    store<i32>(x + (load<i32>(slots + (i << 2)) << 2), load<i32>(numbers + (i << 2)));
  }
}

/** Empties slots. */
export function clearSlots(x: usize, slots: usize, n: usize): void {
  for (let i: usize = 0; i < n; i++) store<i32>(x + (load<i32>(slots + (i << 2)) << 2), 0);
}

/** Writes 0 to the bytes of slots. */
export function clearBytes(x: usize, slots: usize, n: usize): void {
  for (let i: usize = 0; i < n; i++) store<u8>(x + load<i32>(slots + (i << 2)), 0);
}

/** Slots that are live: a byte for each. Their number. `slots` has room for one more. */
export function liveSlots(live: usize, n: i32, slots: usize): i32 {
  let count = 0;
  for (let slot = 0; slot < n; slot++) {
    store<i32>(slots + 4 * count, slot);
    count += load<u8>(live + slot);
  }
  return count;
}
