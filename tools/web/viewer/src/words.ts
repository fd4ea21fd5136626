/** Numbers and failures in words. */

import { LIMITS } from "./limits.js";
import type { FromWorker, Progress } from "./messages.js";
import { REFUSED } from "./originFetch.js";

export function bytes(n: number): string {
  if (n < 1e3) return `${n} B`;
  if (n < 1e6) return `${(n / 1e3).toFixed(n < 1e4 ? 1 : 0)} kB`;
  if (n < 1e9) return `${(n / 1e6).toFixed(n < 1e7 ? 2 : 1)} MB`;
  return `${(n / 1e9).toFixed(2)} GB`;
}

export const count = (n: number): string => n.toLocaleString("en");

export function verified({ digests, failedFiles = [] }: Progress): string {
  if (digests !== null && digests.wrong > 0) return `${digests.wrong} digests differ`;
  if (failedFiles.length > 0)
    return failedFiles.length === 1 ? "1 file missing" : `${failedFiles.length} files missing`;
  if (digests === null || digests.rows === 0) return "no digests";
  return digests.checked === digests.rows ? "verified" : `${digests.checked} of ${digests.rows} digests`;
}

/** The name of a file in an address, as people write it. */
export function nameOf(url: string): string {
  const { pathname, host } = new URL(url);
  return decoded(pathname.split("/").pop() || host);
}

/** A part of an address without its escapes. */
export function decoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** What to tell of a browser that cannot draw. */
export const noWebGlText = (error: unknown): string =>
  `This browser offers no WebGL2, which the viewer needs (${error instanceof Error ? error.message : error}).`;

export const GRAPHICS_TEXT = "The graphics processor was reset. The picture comes back by itself.";

/** What to tell of a link with the view. A scene that is a file of this machine is not in it. */
export const linkText = (isCopied: boolean, isLocal: boolean): string =>
  (isCopied ? "The link is copied." : "The link is in the address bar: the page may not copy it.") +
  (isLocal ? " It has the view, but not your local file." : "");

/** What to tell while nothing comes for so long, in seconds. */
export const quietText = (seconds: number): string =>
  `The server has sent nothing for ${seconds} seconds. The page goes on when bytes come.`;

/** What to tell of a scene while it comes: nothing, if all is well. */
export function progressText(progress: Progress): string {
  const { waitsFor, failedFiles = [], fault, digests } = progress;
  if (waitsFor !== "") return waitingText(progress);
  if (failedFiles.length > 0) return filesText(failedFiles);
  if (fault !== "") return `A packet is damaged (${fault}). Its region stays coarser; the rest goes on.`;
  if (digests !== null && digests.wrong > 0) return "Digests differ: what is shown is not what the encoder made.";
  return "";
}

function waitingText({ waitsFor, splats }: Progress): string {
  const stays = splats > 0 ? " What arrived stays on screen." : "";
  if (waitsFor.includes(REFUSED)) return REFUSED_TEXT;
  const status = statusOf(waitsFor);
  if (status !== null) return `The server answers ${status}: trying again.${stays}`;
  if (splats > 0) return `The connection is interrupted: trying again.${stays}`;
  return "The server does not answer: trying again.";
}

function filesText(files: { name: string; message: string }[]): string {
  const [{ name, message }] = files;
  return files.length === 1
    ? `1 file cannot be read (${name}: ${message}). Its region stays coarser; the rest goes on.`
    : `${files.length} files cannot be read (${name}: ${message}; and others). Their regions stay coarser; the rest goes on.`;
}

/** The status that a message tells of, or null. */
function statusOf(message: string): string | null {
  return /the server answers (\d+)/.exec(message)?.[1] ?? null;
}

const REFUSED_TEXT =
  "The server does not let pages of other origins read the file: it must send Access-Control-Allow-Origin (CORS).";

type Failure = Extract<FromWorker, { kind: "failed" }>;

/** What to tell of a failure, and whether another try may help. */
export function failureText(
  { failure, message }: Failure,
  hasPicture: boolean,
): { text: string; canRetry: boolean } {
  const stays = hasPicture ? " What arrived stays on screen." : "";
  switch (failure) {
    case "status":
      return {
        text: /404/.test(message) ? "There is no such file (404)." : `The file cannot be read: ${message}.`,
        canRetry: true,
      };
    case "lost":
      return { text: lostText(message, hasPicture) + stays, canRetry: true };
    case "bad":
      return { text: badText(message), canRetry: false };
    case "short":
      return { text: `The file is cut short: ${message}.${stays}`, canRetry: true };
    case "changed":
      return { text: `The file on the server has changed. Open it again.${stays}`, canRetry: false };
    case "range":
      return { text: `The server sends other bytes than it was asked for: ${message}.${stays}`, canRetry: true };
    case "internal":
      return { text: `The scene cannot be shown: ${message}.${stays}`, canRetry: false };
  }
}

function lostText(message: string, hasPicture: boolean): string {
  if (message.includes(REFUSED)) return REFUSED_TEXT;
  const status = statusOf(message);
  if (status !== null) return `The server answers ${status}. Try again later.`;
  return hasPicture
    ? "The connection is lost."
    : "The server does not answer. Check the address and the connection.";
}

/** What to tell of a file that cannot be shown. */
function badText(message: string): string {
  const fault = /E_[A-Z]+/.exec(message)?.[0];
  switch (fault) {
    case "E_SIGNATURE":
      return "This is not an EvoGS file.";
    case "E_VERSION":
    case "E_UNSUPPORTED":
      return `The file needs a newer viewer (${fault}). Update evogs, or encode the scene for this one.`;
    case "E_LIMIT":
      return limitText(message);
    case "E_TIER":
      return `The file is larger than its own tier allows (${detailOf(message)}). Encode the scene again.`;
    default:
      return `The file is damaged: ${message}.`;
  }
}

const MADE_SMALLER = "Make a smaller stream (evogs encode --target-bytes) or a tileset (evogs tileset).";

function limitText(message: string): string {
  const [, name, n] = /(\w+) is (\d+)/.exec(message) ?? [];
  if (name === "slots") {
    return `This scene has ${count(Number(n))} slots; the page shows at most ${count(LIMITS.slots)}. ${MADE_SMALLER}`;
  }
  return `This scene is too large for the page (${detailOf(message)}). ${MADE_SMALLER}`;
}

/** What a message says behind its last colon. */
const detailOf = (message: string): string => message.split(": ").pop() ?? message;
