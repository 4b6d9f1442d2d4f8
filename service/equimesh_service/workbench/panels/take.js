// Next to the mesh: its file, its link, and its picture.  The panels Copy and Download have the rest.

import { hashOf } from "../address.js";
import { capabilitiesOf } from "../capabilities.js";
import { element } from "../dom.js";
import { pngOf, svgOf } from "../drawing/picture.js";

// Until the service has said which formats it writes.
const USUAL = [{ name: "vtu", suffix: ".vtu" }];
// Milliseconds for which a button says that it has copied.
const SAID = 2000;

/**
 * The row of downloads, the link and the pictures.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  let formats = USUAL;
  const format = element("select", { "aria-label": "Format of the file" }, optionsOf(formats));
  const get = element("button", { type: "button", class: "primary", onclick: () => app.emit("download", formats.find(({ name }) => name === format.value)) }, "Download");
  const link = element("button", { type: "button", onclick: () => copyLink(link, app) }, "Copy link");
  const picture = (name, make) => element("button", { type: "button", onclick: async () => app.drawing && save(await make(app), `mesh.${name}`) }, `Save ${name.toUpperCase()}`);
  const said = element("p", { class: "hint take-status" });
  section.append(element("div", { class: "row" }, element("span", { class: "joined" }, format, get), link, picture("svg", svgOf), picture("png", pngOf), said));
  app.on("downloading", (text) => (said.textContent = text));
  capabilitiesOf(app).then((found) => {
    formats = found.formats;
    format.replaceChildren(...optionsOf(formats));
    format.value = USUAL[0].name;
  }).catch(() => {}); // the usual format remains
}

const optionsOf = (formats) => formats.map(({ name, suffix }) => element("option", { value: name }, `mesh${suffix}`));

async function copyLink(button, app) {
  const text = location.origin + location.pathname + hashOf(app.store.get());
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = "Copied";
    app.announce("The link is copied.");
  } catch {
    // The clipboard of a page without encryption is closed: the address of the page is the link.
    button.textContent = "It is the address";
  }
  setTimeout(() => (button.textContent = "Copy link"), SAID);
}

/** Hand a file to the browser under its name. */
export function save(blob, name) {
  const link = element("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  // The browser has begun to read it by the next task.
  setTimeout(() => URL.revokeObjectURL(link.href));
}
