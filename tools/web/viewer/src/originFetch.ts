/** `fetch`, which tells servers that refuse pages of other origins from those that do not answer. */

/** What is thrown for a server that answers, but not to this page. */
export const REFUSED = "pages of other origins are refused";

/** Origins that answered this page: what they do not answer later is lost. */
const readable = new Set<string>();

export async function originFetch(input: RequestInfo | URL, init: RequestInit = {}): Promise<Response> {
  const { origin } = new URL(input instanceof Request ? input.url : input, location.href);
  try {
    const answer = await fetch(input, init);
    readable.add(origin);
    return answer;
  } catch (error) {
    const isOther = origin !== location.origin && !readable.has(origin);
    if (isOther && !init.signal?.aborted && (await isThere(input, init.signal))) throw new Error(REFUSED);
    throw error;
  }
}

/** Whether a server answers at all: what it answers remains hidden. */
async function isThere(input: RequestInfo | URL, signal: AbortSignal | null | undefined): Promise<boolean> {
  try {
    await fetch(input, { method: "HEAD", mode: "no-cors", cache: "no-store", signal });
    return true;
  } catch {
    return false;
  }
}
