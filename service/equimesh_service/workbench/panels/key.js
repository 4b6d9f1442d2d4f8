// The field of the API key: kept by this tab alone, until it is closed.

import { element, field } from "../dom.js";

/**
 * The panel of the API key.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const { service } = app;
  const details = section.closest("details");
  const input = element("input", { type: "password", autocomplete: "off", spellcheck: "false", value: service.key, name: "key" });
  const status = element("p", { class: "hint", role: "status" });
  const use = element("button", { type: "submit" }, "Use this key");
  const forget = element("button", { type: "button", onclick: () => take("") }, "Forget it");
  const form = element("form", { onsubmit: (event) => {
    event.preventDefault();
    take(input.value.trim());
  } },
  field("API key", input, { help: "Only for services that require one. This tab keeps it until it is closed; it goes to this service alone." }),
  element("div", { class: "row" }, use, forget), status);
  section.append(form);

  function take(key) {
    service.key = key;
    input.value = key;
    status.textContent = key ? "The key is sent with every request." : "There is no key.";
    app.emit("key", Boolean(key));
    app.live.refresh();
  }

  app.on("problem", (problem) => {
    if (problem?.status !== 401 && problem?.status !== 403) return;
    status.textContent = problem.detail ?? "";
    if (details) details.open = true;
  });
}
