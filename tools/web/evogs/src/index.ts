/** The decoder of the EvoGS bitstream. Sections are those of spec/evogs.md. */

export { Decoder, type DecoderOptions, type Verdict } from "./decoder.js";
export { decode, decodeFloats } from "./decode.js";
export { CallerError, FAULT_SECTIONS, type FaultCode, StreamError } from "./faults.js";
export { type Directory, parseDirectory } from "./directory.js";
export { HEADER_SIZE, type Header } from "./header.js";
export { type Viewpoint, viewpointOf } from "./viewpoint.js";
export type { PacketTable } from "./packetTable.js";
export type { TileTable } from "./tiles.js";
export type { LimitName, Limits } from "./limits.js";
export type { Change, Scene } from "./scene.js";
export type { TileState } from "./tileState.js";
export type { ChannelBlock } from "./channelBlock.js";
export type { SlotRange } from "./dirty.js";
export { CORE, N_COMPONENTS, PALETTE, PICKS, channelCount, channelsOf, classOf, groupOf } from "./model.js";
export { ShownChannels, shownPicks } from "./shown.js";
export { floatView, slotFloats } from "./floatView.js";
export { dump, dumpPieces, dumpSize } from "./dump.js";
export { digestOf } from "./state.js";
export { Sha256, sha256 } from "./sha256.js";
export { crc32 } from "./crc32.js";
