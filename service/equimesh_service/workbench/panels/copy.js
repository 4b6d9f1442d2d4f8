// The panel of copies: what is seen, as a command, a program, or a link.

import { hashOf } from "../address.js";
import { capabilitiesOf } from "../capabilities.js";
import { commandOf } from "../copying/command_line.js";
import { curlOf } from "../copying/curl.js";
import { isExpression } from "../copying/functions.js";
import { clientProgram, solverProgram } from "../copying/python.js";
import { element, field, freshId, select } from "../dom.js";
import { sourcesOf } from "../sources.js";

// Until the service has said which formats it writes.
const USUAL_FORMAT = { name: "vtu", suffix: ".vtu" };
// Milliseconds for which the button says that it has copied.
const SAID = 2000;

/** The kinds of copies: `make(state, options)` returns `{text}`, or `{missing}`, a sentence. */
const COPIES = [
  { name: "curl", title: "curl", hasFile: true, make: ({ spec }, options) => ({ text: curlOf(spec, options) }) },
  { name: "python", title: "Python", hasFile: true, make: ({ spec }, options) => ({ text: clientProgram(spec, options) }) },
  { name: "solver", title: "Python, without a service", hasFile: true, make: ({ spec }, options) => inProcess(spec, options) },
  { name: "command", title: "Command line", hasFile: true, make: ({ spec }, options) => commandOf(spec, options) },
  { name: "link", title: "Link", make: (state) => linkOf(state) },
  { name: "spec", title: "Spec (JSON)", make: ({ spec }) => ({ text: JSON.stringify(spec, null, 2) }) },
];

/**
 * The panel of copies.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  let formats = [USUAL_FORMAT];
  let chosen = COPIES[0];
  const text = element("pre", { class: "copy-text", tabindex: 0, role: "region", "aria-label": "What is copied", id: freshId("copy") });
  const said = element("p", { class: "hint", role: "status" });
  const copy = element("button", { type: "button", class: "primary", onclick: () => copied(text.textContent) }, "Copy");
  const kind = select(COPIES.map(({ name, title }) => ({ value: name, text: title })), chosen.name, (name) => {
    chosen = COPIES.find((one) => one.name === name);
    show();
  });
  const format = element("select", { onchange: show });
  const formatField = field("File", format, { inline: true });
  section.append(field("Copy as", kind, { inline: true }), formatField, text, element("div", { class: "row" }, copy), said);

  function show() {
    const { service, store } = app;
    const options = {
      url: service.root.href,
      format: formats.find((one) => one.name === format.value) ?? USUAL_FORMAT,
      hasKey: Boolean(service.key),
    };
    const made = chosen.make(store.get(), options);
    text.textContent = made.text ?? "";
    text.hidden = made.text === undefined;
    copy.disabled = made.text === undefined;
    said.textContent = made.missing ?? made.note ?? "";
    formatField.hidden = !chosen.hasFile || made.text === undefined;
  }

  async function copied(words) {
    const isCopied = await toClipboard(words, text);
    copy.textContent = isCopied ? "Copied" : "Copy";
    said.textContent = isCopied ? "Copied." : "The browser does not let this page copy. The text is selected: press Ctrl+C, or Cmd+C.";
    if (isCopied) setTimeout(() => (copy.textContent = "Copy"), SAID);
  }

  capabilitiesOf(app).then((found) => {
    formats = found.formats;
    format.replaceChildren(...formats.map(({ name, suffix }) => element("option", { value: name }, `mesh${suffix}`)));
    show();
  }).catch(() => {}); // the usual format remains
  app.store.subscribe(show);
  app.on("key", show);
  show();
}

// The clipboard of a page without encryption is closed: there the text is selected, for the keys of the visitor.
async function toClipboard(words, place) {
  try {
    await navigator.clipboard.writeText(words);
    return true;
  } catch {
    getSelection().selectAllChildren(place);
    place.focus();
    return false;
  }
}

function inProcess(spec, options) {
  const isWhole = sourcesOf(spec).every(({ source }) => isExpression(source));
  return isWhole ? { text: solverProgram(spec, options) } : { missing: "The samples are at the service: copy Python, which requests the mesh there." };
}

function linkOf(state) {
  const page = location.origin + location.pathname;
  const hash = hashOf(state);
  const isWhole = sourcesOf(state.spec).every(({ source }) => isExpression(source));
  const note = isWhole ? "" : "The samples stay at this service for a limited time. After that the link shows no mesh.";
  return { text: page + hash, note };
}
