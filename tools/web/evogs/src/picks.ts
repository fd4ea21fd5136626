/** A step of picks (spec 12.4, 12.5). A slot keeps its pick; its SH are those of the entry. */

import { PICKS_OF_CHANGED } from "./lists.js";
import type { PacketLists } from "./packet.js";
import { type StepRecords, planOf } from "./records.js";
import type { TileState } from "./tileState.js";
import { PLAIN, type Workspace } from "./workspace.js";

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
  else picks.fill(0, 0, nNew);
  for (let i = 0; i < nChanged + nNew; i++) if (picks[i] > nEntries) return false;

  const end = tile.nPicks + nNew;
  tile.reservePicks(end);
  for (let i = 0; i < nChanged; i++) tile.picks[plan.psiSlots[i]] = picks[i];
  for (let i = 0; i < nNew; i++) tile.picks[tile.nPicks + i] = picks[nChanged + i];
  for (let i = 0; i < plan.nDrops; i++) tile.picks[plan.drops[i]] = 0;
  tile.nPicks = end;
  return true;
}
