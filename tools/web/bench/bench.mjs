/**
 * The figures of docs/viewer.md:
 *
 *     npm run bench -- [--only decoding,first,update,requests,bundles] NAME=SCENE.evogs[,SCENE.spz] ...
 *
 * It prints tables in Markdown. `requests` fetches the last scene at 10 Mbit/s in real time.
 */

import { decoding } from "./decode.mjs";
import { bundles } from "./bundles.mjs";
import { firstPictures } from "./first.mjs";
import { requests } from "./requests.mjs";
import { updates } from "./update.mjs";

const TABLES = {
  decoding: [decoding, "Decoding to float arrays, ms"],
  first: [firstPictures, "First picture"],
  update: [updates, "An update of 2,048 splats, ms"],
  requests: [requests, "A whole scene at 10 Mbit/s"],
  bundles: [bundles, "Bundles, bytes"],
};

const words = process.argv.slice(2);
const at = words.indexOf("--only");
const only = at < 0 ? Object.keys(TABLES) : words.splice(at, 2)[1].split(",");
const scenes = words.map((word) => {
  const [name, files] = word.split("=");
  const [stream, spzFile] = (files ?? "").split(",");
  if (!stream) throw new Error(`${word}: expected NAME=SCENE.evogs[,SCENE.spz]`);
  return { name, stream, spzFile };
});

for (const name of only) {
  const [measure, title] = TABLES[name];
  const rows = await measure(scenes);
  if (rows.length === 0) continue;
  const columns = Object.keys(rows[0]);
  console.log(`\n${title}\n\n| ${columns.join(" | ")} |\n|${columns.map(() => "---|").join("")}`);
  for (const row of rows) console.log(`| ${columns.map((column) => cell(row[column])).join(" | ")} |`);
}

function cell(value) {
  if (typeof value !== "number") return String(value);
  if (Number.isNaN(value)) return "";
  if (Number.isInteger(value)) return value.toLocaleString("en");
  return value.toFixed(value < 10 ? 2 : value < 100 ? 1 : 0);
}
