/** A step of picks (spec 12.4, 12.5). A slot keeps its pick; its SH are those of the entry. */

import { PICKS_OF_CHANGED } from "./lists.js";
import type { PacketLists } from "./packet.js";
import { type StepPlan, type StepRecords, planOf } from "./records.js";
import type { TileState } from "./tileState.js";
import { PLAIN, type Workspace } from "./workspace.js";

/** The picks of the new slots of a packet of size 0: a C2 has that of its parent, an add has none. */
function inherit(tile: TileState, plan: StepPlan, picks: Int32Array): void {
  for (let i = 0; i < plan.nSplits; i++) picks[i] = tile.picks[plan.parents[i]];
  picks.fill(0, plan.nSplits, plan.nSplits + plan.nAdds);
}

/** Applies a packet of picks. False if a pick is above `nEntries`: nothing is changed then. */
export function applyPicks(
  tile: TileState,
  records: StepRecords,
  lists: PacketLists | null,
  nEntries: number,
  workspace: Workspace,
): boolean {
  const plan = planOf(records, workspace);
  const nNew = plan.nSplits + plan.nAdds;
  const nChanged = lists !== null && (lists.flags & PICKS_OF_CHANGED) !== 0 ? plan.nPsi : 0;
  const picks = workspace.integers(PLAIN, nChanged + nNew);
  if (lists !== null) lists.read(lists.layout.picks, picks);
  else inherit(tile, plan, picks);
  for (let i = 0; i < nChanged + nNew; i++) if (picks[i] > nEntries) return false;

  const end = tile.nPicks + nNew;
  tile.reservePicks(end);
  for (let i = 0; i < nChanged; i++) tile.picks[plan.psiSlots[i]] = picks[i];
  for (let i = 0; i < nNew; i++) tile.picks[tile.nPicks + i] = picks[nChanged + i];
  for (let i = 0; i < plan.nDrops; i++) tile.picks[plan.drops[i]] = 0;
  tile.nPicks = end;
  return true;
}
