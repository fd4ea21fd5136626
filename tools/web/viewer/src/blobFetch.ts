/** Local files behind the interface of `fetch`. */

/** Answers requests for ranges from a file of the user's. */
export function blobFetch(file: Blob): typeof fetch {
  return async (_input, init) => {
    const range = new Headers(init?.headers).get("range") ?? "";
    const [, from, to] = /^bytes=(\d+)-(\d+)$/.exec(range) ?? [];
    const start = Number(from);
    if (start >= file.size) return new Response(null, { status: 416 });
    const end = Math.min(Number(to) + 1, file.size);
    const headers = { "Content-Range": `bytes ${start}-${end - 1}/${file.size}` };
    return new Response(file.slice(start, end).stream(), { status: 206, headers });
  };
}
