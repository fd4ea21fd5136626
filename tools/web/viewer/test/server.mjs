/** Serves the built page and scenes, slowly if asked to, and can go away and come back. */

import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { fileURLToPath } from "node:url";

const DIST = fileURLToPath(new URL("../dist/", import.meta.url));
const TYPES = { html: "text/html", js: "text/javascript", css: "text/css" };

export class PageServer {
  /** Scenes by name: bytes. */
  scenes = new Map();
  /** Of each scene no byte is sent from here on, until it is raised. */
  gate = Number.POSITIVE_INFINITY;
  bytesPerSecond = 0;
  /** Names whose requests wait for their answers. */
  held = new Set();
  /** Requests for scenes are answered with this status; 0 for the bytes. */
  status = 0;
  /** The ranges that were asked for, and the bytes of scenes that were sent. */
  requests = [];
  sent = 0;
  port = 0;
  server = null;

  async start() {
    this.server = createServer((request, response) => void this.answer(request, response));
    await new Promise((resolve) => this.server.listen(this.port, "127.0.0.1", resolve));
    this.port = this.server.address().port;
  }

  /** Drops all connections and listens no more. */
  async stop() {
    this.server.closeAllConnections();
    await new Promise((resolve) => this.server.close(resolve));
  }

  url(scene) {
    return `http://127.0.0.1:${this.port}/?src=${scene}`;
  }

  async answer(request, response) {
    const name = new URL(request.url, "http://x").pathname.slice(1) || "index.html";
    while (this.held.has(name)) await new Promise((resolve) => setTimeout(resolve, 20));
    const scene = this.scenes.get(name);
    if (scene !== undefined) return this.sendScene(request, response, scene);
    try {
      const body = await readFile(DIST + name);
      response.writeHead(200, { "Content-Type": TYPES[name.split(".").pop()] ?? "text/plain" }).end(body);
    } catch {
      response.writeHead(404).end();
    }
  }

  async sendScene(request, response, bytes) {
    this.requests.push(request.headers.range ?? "all");
    if (this.status !== 0) return response.writeHead(this.status).end();
    const [, from, to] = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "") ?? [];
    const start = Number(from ?? 0);
    const end = Math.min(Number(to ?? bytes.length) + 1, bytes.length);
    if (start >= bytes.length) return response.writeHead(416).end();
    response.writeHead(206, {
      "Content-Length": end - start,
      "Content-Range": `bytes ${start}-${end - 1}/${bytes.length}`,
      ETag: `"${bytes.length}"`,
    });
    response.flushHeaders();
    for (let at = start; at < end && !response.destroyed; ) {
      const step = this.bytesPerSecond ? Math.ceil(this.bytesPerSecond / 50) : 65536;
      const stop = Math.min(end, at + step, this.gate);
      if (stop > at) {
        response.write(bytes.subarray(at, stop));
        this.sent += stop - at;
        at = stop;
      }
      if (this.bytesPerSecond || at >= this.gate) await new Promise((resolve) => setTimeout(resolve, 20));
    }
    response.end();
  }
}
