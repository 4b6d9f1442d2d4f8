// Controls that are bound to one place of the spec: they show its value, and write it.

import { element, field, freshId, select } from "./dom.js";
import { replaced } from "./store.js";

// Without a key of their own these objects mean the same as if they were absent.
const DROPPED_WHEN_EMPTY = ["grid", "domain"];

/**
 * Write one place of the spec.  A value that is the default is left out, so that specs stay short.
 *
 * @param {object} app
 * @param {(string|number)[]} path within the spec, such as ["grid", "n_xi"]
 * @param {any} value `undefined` deletes the key
 * @param {any} [fallback] the default of the service
 */
export function write(app, path, value, fallback) {
  const kept = same(value, fallback) ? undefined : value;
  app.store.update((state) => ({ spec: tidy(replaced(state.spec, path, kept)) }));
}

/** A spec without the objects that say nothing. */
export function tidy(spec) {
  const empty = DROPPED_WHEN_EMPTY.filter((name) => spec[name] && Object.keys(spec[name]).length === 0);
  return empty.reduce((rest, name) => replaced(rest, [name], undefined), spec);
}

/**
 * Call `refresh` with the value at a place of the spec, now and after every change of the spec.
 *
 * @param {object} app
 * @param {(string|number)[]} path
 * @param {(value: any) => void} refresh
 */
export function follow(app, path, refresh) {
  const read = () => app.store.at(["spec", ...path]);
  refresh(read());
  return app.store.subscribe((state, before) => {
    if (state.spec !== before.spec) refresh(read());
  });
}

/**
 * An app whose listeners all end together, for controls that are made and removed again.
 *
 * @param {object} app
 * @returns {{app: object, end: () => void}}
 */
export function scoped(app) {
  const ends = [];
  const kept = (begin) => (...values) => {
    const end = begin(...values);
    ends.push(end);
    return end;
  };
  const inner = Object.create(app, {
    on: { value: kept(app.on) },
    store: { value: { ...app.store, subscribe: kept(app.store.subscribe) } },
  });
  return { app: inner, end: () => ends.splice(0).forEach((end) => end()) };
}

/** The JSON pointer of a place of the spec. */
export const pointerOf = (path) => `/${path.join("/")}`;

/**
 * A field for a number.
 *
 * @param {object} app
 * @param {string} label
 * @param {(string|number)[]} path
 * @param {{fallback?: number|null, help?: string, optional?: boolean}} options further keys are attributes of the input;
 *   an `optional` number may be empty
 */
export function numberField(app, label, path, { fallback, help, optional = false, ...attributes } = {}) {
  const input = element("input", { type: "number", step: "any", inputmode: "decimal", ...attributes });
  const box = field(label, input, { app, pointer: pointerOf(path), help, inline: true });
  input.addEventListener("input", () => {
    const value = input.valueAsNumber;
    const isEmpty = input.value === "" && !input.validity.badInput;
    const isUsable = Number.isFinite(value) || (isEmpty && optional);
    complain(box, input, isUsable ? "" : "Type a number.");
    if (isUsable) write(app, path, isEmpty ? undefined : value, fallback);
  });
  follow(app, path, (value) => {
    const text = value ?? fallback ?? "";
    if (document.activeElement === input && (input.valueAsNumber === text || input.value === "")) return;
    input.value = text;
    if (input.getAttribute("aria-invalid")) complain(box, input, "");
  });
  return box;
}

/**
 * A field for a whole number of few, as a slider with words for each.
 *
 * @param {object} app
 * @param {string} label
 * @param {(string|number)[]} path
 * @param {{fallback: number, min: number, max: number, wordsOf: (value: number) => string, help?: string}} options
 */
export function sliderField(app, label, path, { fallback, min, max, wordsOf, help }) {
  const words = element("output", {});
  const input = element("input", { type: "range", step: 1, min, max, oninput: () => write(app, path, input.valueAsNumber, fallback) });
  const box = field(label, input, { app, pointer: pointerOf(path), help });
  words.htmlFor = input.id;
  box.firstChild.after(words);
  follow(app, path, (value) => {
    input.value = value ?? fallback;
    words.value = wordsOf(input.valueAsNumber);
    input.setAttribute("aria-valuetext", words.value);
  });
  return box;
}

/** A field for true or false. */
export function flagField(app, label, path, { fallback = false, help } = {}) {
  const input = element("input", { type: "checkbox", onchange: () => write(app, path, input.checked, fallback) });
  follow(app, path, (value) => (input.checked = value ?? fallback));
  return field(label, input, { app, pointer: pointerOf(path), help, inline: true });
}

/**
 * A field for one of several words.
 *
 * @param {object} app
 * @param {string} label
 * @param {(string|number)[]} path
 * @param {{choices: [string, string][], fallback: string|null, uses?: Promise<Object<string, string>>, help?: string,
 *   onchoose?: (value: string) => void}} options `choices` are values with their words; "" stands for null; `uses` say
 *   when to take which one; `onchoose` replaces the write
 */
export function choiceField(app, label, path, { choices, fallback, uses, help, onchoose }) {
  const chosen = () => app.store.at(["spec", ...path]) ?? fallback ?? "";
  const choose = onchoose ?? ((value) => write(app, path, value === "" ? null : value, fallback));
  const input = select(choices.map(([value, text]) => ({ value, text })), chosen(), (value) => {
    choose(value);
    describe(value);
  });
  const box = field(label, input, { app, pointer: pointerOf(path), help });
  const use = element("p", { class: "hint", id: freshId("use") });
  let known = {};
  const describe = (value) => (use.textContent = known[value] ?? "");
  if (uses) {
    input.after(use);
    input.setAttribute("aria-describedby", `${use.id} ${input.getAttribute("aria-describedby")}`);
    uses.then((found) => {
      known = found;
      describe(chosen());
    }).catch(() => {}); // without the capabilities there are no descriptions
  }
  follow(app, path, (value) => {
    input.value = value ?? fallback ?? "";
    describe(input.value);
  });
  return box;
}

/**
 * A field for a number, or one of some words such as "auto".
 *
 * @param {object} app
 * @param {string} label
 * @param {(string|number)[]} path
 * @param {{words: [string, string][], fallback: string|number, number: number, help?: string}} options `words` as the
 *   choices of `choiceField`; `number` is the one that a change to a number begins with
 */
export function wordOrNumberField(app, label, path, { words, fallback, number, help, ...attributes }) {
  const toValue = (word) => (word === "" ? null : word);
  const input = element("input", { type: "number", step: "any", "aria-label": `${label}, a number`, ...attributes });
  const put = (value) => write(app, path, value, fallback);
  const choices = [...words, ["number", "a number"]].map(([value, text]) => ({ value, text }));
  const words_ = select(choices, "number", (word) => put(word === "number" ? number : toValue(word)));
  input.addEventListener("input", () => Number.isFinite(input.valueAsNumber) && put(input.valueAsNumber));
  const box = field(label, words_, { app, pointer: pointerOf(path), help });
  words_.after(input);
  follow(app, path, (found) => {
    const value = found === undefined ? fallback : found;
    input.hidden = typeof value !== "number";
    words_.value = input.hidden ? (value ?? "") : "number";
    if (!input.hidden && input.valueAsNumber !== value) input.value = value;
  });
  return box;
}

/** Two fields for a pair of numbers such as the ends of a rectangle in x. */
export function pairFields(app, labels, path, fallback, attributes = {}) {
  const boxes = labels.map((label, k) => {
    const input = element("input", { type: "number", step: "any", inputmode: "decimal", ...attributes });
    const box = field(label, input, { app, pointer: pointerOf([...path, k]), inline: true });
    input.addEventListener("input", () => {
      const isUsable = Number.isFinite(input.valueAsNumber);
      complain(box, input, isUsable ? "" : "Type a number.");
      const pair = [...(app.store.at(["spec", ...path]) ?? fallback)];
      pair[k] = input.valueAsNumber;
      if (isUsable) write(app, path, pair, fallback);
    });
    follow(app, path, (pair) => {
      const value = (pair ?? fallback)[k];
      if (input.valueAsNumber !== value && !(document.activeElement === input && input.value === "")) input.value = value;
    });
    return box;
  });
  return element("div", { class: "pair" }, boxes);
}

/**
 * A line for the faults of an answer that belong to a whole panel, with pointers such as "/domain".
 *
 * @param {object} app
 * @param {(pointer: string) => boolean} isMine
 */
export function faultLine(app, isMine) {
  const line = element("p", { class: "fault", role: "alert" });
  app.on("problem", (problem) => {
    const mine = (problem?.errors ?? []).filter((each) => each.pointer !== undefined && isMine(each.pointer));
    line.textContent = mine.map((each) => each.message).join("; ");
  });
  return line;
}

function complain(box, input, text) {
  box.querySelector(".fault").textContent = text;
  if (text) input.setAttribute("aria-invalid", "true");
  else input.removeAttribute("aria-invalid");
}

function same(a, b) {
  if (Array.isArray(a) && Array.isArray(b)) return a.length === b.length && a.every((value, k) => value === b[k]);
  return a === b;
}
