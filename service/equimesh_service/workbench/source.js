// A function of x and y in a spec: its expression, and the values of the names in it.

import { follow, pointerOf, write } from "./bound.js";
import { element, field } from "./dom.js";
import { freeNames } from "./panels/function.js";

// The value of a name that has none yet.
const FIRST_VALUE = 1;

/**
 * A field for a function besides u, such as the density of a weight.
 *
 * @param {object} app
 * @param {string} label
 * @param {(string|number)[]} path its place in the spec
 * @param {{help?: string, optional?: boolean}} [options] an `optional` function is left out where the field is empty
 */
export function sourceField(app, label, path, { help, optional = false } = {}) {
  const input = element("input", { type: "text", class: "code", spellcheck: "false", autocomplete: "off", autocapitalize: "off" });
  const pointer = pointerOf(path);
  const box = field(label, input, { app, pointer, help });
  const names = element("div", { class: "names" });
  const note = element("p", { class: "hint" });
  input.addEventListener("input", () => {
    const isLeftOut = optional && input.value.trim() === "";
    write(app, path, isLeftOut ? undefined : { ...parsed(input.value), ...timeOf(app.store.at(["spec", ...path])) });
  });

  function parsed(expression) {
    const before = app.store.at(["spec", ...path])?.parameters ?? {};
    const words = freeNames(expression).filter((name) => name !== "t");
    const parameters = Object.fromEntries(words.map((name) => [name, before[name] ?? FIRST_VALUE]));
    return words.length ? { expression, parameters } : { expression };
  }

  function show(source) {
    const text = expressionOf(source);
    note.textContent = source && text === null ? "Samples from a file. Typing an expression replaces them." : "";
    if (input.value !== (text ?? "")) input.value = text ?? "";
    showNames(names, app, path, Object.keys(source?.parameters ?? {}));
  }

  app.on("problem", (problem) => {
    const mine = (problem?.errors ?? []).find((one) => one.pointer?.startsWith(`${pointer}/`) && one.position);
    if (mine) box.querySelector(".fault").textContent = `${mine.message} (at character ${mine.position.column})`;
  });
  box.append(note, names);
  follow(app, path, show);
  return box;
}

/** The text of a function; null for samples and for no function. */
export function expressionOf(source) {
  if (typeof source === "string") return source;
  return source?.expression ?? null;
}

function timeOf(source) {
  return source?.t === undefined ? {} : { t: source.t };
}

// Numbers for the names; the inputs are made anew only where the names have changed.
function showNames(names, app, path, wanted) {
  const inputs = [...names.querySelectorAll("input")];
  if (inputs.map((input) => input.dataset.name).join() !== wanted.join()) {
    names.replaceChildren(...wanted.map((name) => nameField(app, path, name)));
  }
  for (const input of names.querySelectorAll("input")) {
    const value = app.store.at(["spec", ...path, "parameters", input.dataset.name]);
    if (input.valueAsNumber !== value && document.activeElement !== input) input.value = value;
  }
}

function nameField(app, path, name) {
  const place = [...path, "parameters", name];
  const input = element("input", { type: "number", step: "any", "data-name": name, value: app.store.at(["spec", ...place]) });
  input.addEventListener("input", () => Number.isFinite(input.valueAsNumber) && write(app, place, input.valueAsNumber));
  return field(name, input, { inline: true });
}
