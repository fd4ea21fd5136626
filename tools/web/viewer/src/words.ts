/** Numbers and failures in words. */

import type { FromWorker, Progress } from "./messages.js";

export function bytes(n: number): string {
  if (n < 1e3) return `${n} B`;
  if (n < 1e6) return `${(n / 1e3).toFixed(n < 1e4 ? 1 : 0)} kB`;
  if (n < 1e9) return `${(n / 1e6).toFixed(n < 1e7 ? 2 : 1)} MB`;
  return `${(n / 1e9).toFixed(2)} GB`;
}

export const count = (n: number): string => n.toLocaleString("en");

export function verified({ digests }: Progress): string {
  if (digests === null || digests.rows === 0) return "no digests";
  if (digests.wrong > 0) return `${digests.wrong} digests differ`;
  return digests.checked === digests.rows ? "verified" : `${digests.checked} of ${digests.rows} digests`;
}

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
      return hasPicture
        ? { text: `The connection is lost.${stays}`, canRetry: true }
        : {
            text: "The server does not answer, or does not allow pages of other origins to read the file.",
            canRetry: true,
          };
    case "bad":
      return {
        text: /E_SIGNATURE/.test(message) ? "This is not an EvoGS file." : `The file is damaged: ${message}.`,
        canRetry: false,
      };
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
