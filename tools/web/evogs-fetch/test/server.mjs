/** A static server that can be told to misbehave. It counts what it sends. */

import { createServer } from "node:http";

export async function serve(bytes, behaviour = {}) {
  const log = { requests: [], sent: 0 };
  const state = { bytes, ...behaviour };
  const server = createServer((request, response) => {
    const { bytes: file, ranges = true, status, bytesPerSecond, dropAfter, flaky, endless, tag } = state;
    log.requests.push(request.headers.range ?? "all");
    if (status) {
      response.writeHead(status).end();
      return;
    }
    if (flaky > 0) {
      state.flaky--;
      request.socket.destroy();
      return;
    }
    const [, from, to] = /^bytes=(\d+)-(\d*)$/.exec(request.headers.range ?? "") ?? [];
    const isRange = ranges && from !== undefined;
    const start = isRange ? Number(from) : 0;
    const end = isRange && to !== "" ? Math.min(Number(to) + 1, file.length) : file.length;
    if (isRange && start >= file.length) {
      response.writeHead(416, { "Content-Range": `bytes */${file.length}` }).end();
      return;
    }
    const headers = { "Content-Length": end - start };
    if (tag) headers.ETag = tag;
    if (isRange) headers["Content-Range"] = `bytes ${start}-${end - 1}/${file.length}`;
    response.writeHead(isRange ? 206 : 200, headers);
    if (endless) return void response.flushHeaders();
    send(request, response, file.subarray(start, end), { bytesPerSecond, dropAfter });
  });

  function send(request, response, part, { bytesPerSecond, dropAfter }) {
    let at = 0;
    const step = bytesPerSecond ? Math.ceil(bytesPerSecond / 50) : 16384;
    const next = () => {
      if (response.destroyed) return;
      if (dropAfter !== undefined && log.sent >= dropAfter) {
        state.dropAfter = undefined;
        request.socket.destroy();
        return;
      }
      const piece = part.subarray(at, at + step);
      at += piece.length;
      log.sent += piece.length;
      const isLast = at >= part.length;
      const go = () => (isLast ? response.end() : bytesPerSecond ? setTimeout(next, 20) : setImmediate(next));
      if (response.write(piece)) go();
      else response.once("drain", go);
    };
    next();
  }

  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address();
  return {
    url: `http://127.0.0.1:${port}/scene.evogs`,
    log,
    state,
    close: () => {
      server.closeAllConnections();
      return new Promise((resolve) => server.close(resolve));
    },
  };
}
