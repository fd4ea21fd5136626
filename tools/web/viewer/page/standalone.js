/** Starts the viewer from what a page of `evogs export-html` holds: packed modules, and a scene. */

const unpacked = async (element) => {
  const answer = await fetch(`data:application/octet-stream;base64,${element.textContent}`);
  element.remove();
  return answer.blob();
};

document.body.dataset.standalone = "";
const scene = document.querySelector("script[data-scene]");
const { scene: name, up } = scene.dataset;
window.evogsScene = new File([await unpacked(scene)], name);
window.evogsUp = up;

/** Addresses of the modules. Each module stands behind those that it names. */
const addresses = new Map();
for (const element of document.querySelectorAll("script[data-module]")) {
  const { module } = element.dataset;
  const stream = (await unpacked(element)).stream().pipeThrough(new DecompressionStream("gzip"));
  let text = await new Response(stream).text();
  for (const [other, address] of addresses) {
    for (const word of [`"./${other}"`, `"${other}"`]) text = text.replaceAll(word, `"${address}"`);
  }
  addresses.set(module, URL.createObjectURL(new Blob([text], { type: "text/javascript" })));
}
await import(addresses.get("viewer.js"));
