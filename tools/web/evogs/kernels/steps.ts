/** What a step does to the numbers of a tile (spec 7.2, 7.3). All integers have 4 bytes, unless said. */

const SPLIT: i32 = 1;
const DROP: i32 = 2;
const NONE: i32 = -1;

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

/** Whether all `n` integers are at most `most`. They are not negative. */
export function areAtMost(values: usize, n: usize, most: i32): bool {
  let margin: i32 = 0;
  for (let i: usize = 0; i < n; i++) margin |= most - load<i32>(values + (i << 2));
  return margin >= 0;
}

/**
 * Pairs of places, of each record and of that whose slot it was born from, where there is one. Slots increase, so
 * that record is an earlier one. Their number.
 * `places` has room for as many integers as there are slots, and holds anything. `growth` has room for `n`.
 * Behind the pairs stands how many differences are added to one integer at most, and one.
 */
export function siblingsOf(
  slots: usize,
  n: i32,
  bornFrom: usize,
  places: usize,
  growth: usize,
  pairs: usize,
): i32 {
  let nPairs = 0;
  let most = 1;
  for (let i = 0; i < n; i++) {
    const slot = load<i32>(slots + 4 * i);
    const parent = load<i32>(bornFrom + 4 * slot);
    const place = parent < 0 ? NONE : load<i32>(places + 4 * parent);
    store<i32>(places + 4 * slot, i);
    store<i32>(growth + 4 * i, 1);
    if (place < 0 || place >= i || load<i32>(slots + 4 * place) !== parent) continue;
    store<i32>(pairs + 8 * nPairs, i, 0);
    store<i32>(pairs + 8 * nPairs, place, 4);
    nPairs++;
    const sums = load<i32>(growth + 4 * place) + 1;
    store<i32>(growth + 4 * place, sums);
    store<i32>(growth + 4 * i, sums);
    most = max(most, sums);
  }
  store<i32>(pairs + 8 * nPairs, most);
  return nPairs;
}

/** The integers of a list of sibling differences, in place. */
export function addSiblings(values: usize, pairs: usize, n: usize): void {
  const end = pairs + (n << 3);
  for (let pair = pairs; pair < end; pair += 8) {
    const at = values + (load<i32>(pair, 0) << 2);
    const to = values + (load<i32>(pair, 4) << 2);
    const difference = load<i32>(at);
    const before = load<i32>(to);
    store<i32>(at, before - difference);
    store<i32>(to, before + difference);
  }
}

/** Adds Delta to the numbers of slots. */
export function addDelta(x: usize, slots: usize, n: usize, delta: usize): void {
  for (let i: usize = 0; i < n << 2; i += 4) {
    const at = x + (load<i32>(slots + i) << 2);
    store<i32>(at, load<i32>(at) + load<i32>(delta + i));
  }
}

/** Whether the numbers of slots are within least .. most. */
export function areSlotsWithin(x: usize, slots: usize, n: usize, least: i32, most: i32): bool {
  let margin: i32 = 0;
  for (let i: usize = 0; i < n; i++) {
    const value = load<i32>(x + (load<i32>(slots + (i << 2)) << 2));
    margin |= i32(value < least) | i32(value > most);
  }
  return margin === 0;
}

/** Whether `n` numbers are within least .. most. */
export function areWithin(x: usize, n: usize, least: i32, most: i32): bool {
  let margin: i32 = 0;
  for (let i: usize = 0; i < n; i++) {
    const value = load<i32>(x + (i << 2));
    margin |= i32(value < least) | i32(value > most);
  }
  return margin === 0;
}

/** Whether no product of alpha and Delta of a split is further from 0 than `most`: see `writeSeconds`. */
export function areProductsWithin(
  splits: usize,
  n: usize,
  delta: usize,
  entries: usize,
  indices: usize,
  most: i32,
): bool {
  const bound: i64 = most;
  let margin: i64 = 0;
  for (let j: usize = 0; j < n << 2; j += 4) {
    const index: usize = indices === 0 ? 0 : load<i32>(indices + j);
    const d: i64 = load<i32>(delta + (load<i32>(splits + j) << 2));
    const product = d * load<i16>(entries + (index << 1));
    margin |= (bound - product) | (bound + product);
  }
  return margin >= 0;
}

/**
 * Second children P - round(alpha * Delta) of splits, from P before the step, to the slots from `first` on.
 * `indices` are those of the entries, 2 bytes each, or 0 if all are 0.
 */
export function writeSeconds(
  x: usize,
  first: usize,
  splits: usize,
  parents: usize,
  n: usize,
  delta: usize,
  entries: usize,
  shift: i32,
  indices: usize,
): void {
  const half: i32 = (1 << shift) >> 1;
  let a: i32 = load<i16>(entries);
  for (let j: usize = 0; j < n << 2; j += 4) {
    const d = load<i32>(delta + (load<i32>(splits + j) << 2));
    if (indices !== 0) a = load<i16>(entries + (load<i32>(indices + j) << 1));
    const parent = load<i32>(x + (load<i32>(parents + j) << 2));
    store<i32>(x + (first << 2) + j, parent - ((d * a + half) >> shift));
  }
}

/** Second children where Delta is 0: copies of P. */
export function copySlots(x: usize, first: usize, parents: usize, n: usize): void {
  for (let j: usize = 0; j < n; j++) {
    store<i32>(x + ((first + j) << 2), load<i32>(x + (load<i32>(parents + (j << 2)) << 2)));
  }
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
