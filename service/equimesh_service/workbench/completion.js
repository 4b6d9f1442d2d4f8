// The names of the language of formulas, completed while one types.

import { element, freshId } from "./dom.js";
import { NAMES } from "./formula.js";

// A word of fewer letters is completed by too many names.
const FEWEST_LETTERS = 2;
const MOST_NAMES = 6;

/**
 * The names that begin with the word before a place in a text: `{word, names}`; no names where the word is whole, or
 * the place is inside one.
 *
 * @param {string} text
 * @param {number} place between two characters
 * @param {string[]} own further names, such as those of parameters
 */
export function completionsOf(text, place, own = []) {
  const word = /(?<![\w.])[A-Za-z_]\w*$/.exec(text.slice(0, place))?.[0] ?? "";
  const isInside = /^\w/.test(text.slice(place));
  const known = [...own, ...NAMES.map(({ name }) => name)];
  if (isInside || word.length < FEWEST_LETTERS || known.includes(word)) return { word, names: [] };
  return { word, names: known.filter((name) => name.startsWith(word)).slice(0, MOST_NAMES) };
}

/** A text with the word before a place completed to a name, and the place after it; functions get their bracket. */
export function completed(text, place, { word, name }) {
  const isFunction = NAMES.some((one) => one.name === name && one.isFunction);
  const hasBracket = /^\s*\(/.test(text.slice(place));
  const added = name.slice(word.length) + (isFunction && !hasBracket ? "(" : "");
  return { text: text.slice(0, place) + added + text.slice(place), place: place + added.length };
}

/**
 * A list of names under a field: arrow keys choose one, Enter or a click takes it, Escape closes the list.
 *
 * @param {HTMLTextAreaElement} field
 * @param {{own: () => string[], onTake: () => void, onShow: () => void}} options `onTake` is called after the text has changed
 * @returns {{list: HTMLElement, close: () => void}}
 */
export function createCompletion(field, { own, onTake, onShow }) {
  const list = element("ul", { class: "names-list", role: "listbox", id: freshId("names"), "aria-label": "Names that fit", hidden: true });
  field.setAttribute("aria-autocomplete", "list");
  field.setAttribute("aria-controls", list.id);
  let found = { word: "", names: [] };
  let chosen = -1;

  function show(next) {
    found = next;
    chosen = -1;
    list.hidden = !found.names.length;
    list.replaceChildren(...found.names.map((name, k) =>
      element("li", { role: "option", id: `${list.id}-${k}`, "aria-selected": "false", onpointerdown: (event) => {
        event.preventDefault(); // the field keeps the focus
        take(name);
      } }, name)));
    field.removeAttribute("aria-activedescendant");
    onShow();
  }

  function choose(k) {
    chosen = (k + found.names.length) % found.names.length;
    [...list.children].forEach((item, number) => item.setAttribute("aria-selected", String(number === chosen)));
    field.setAttribute("aria-activedescendant", list.children[chosen].id);
  }

  function take(name) {
    const next = completed(field.value, field.selectionStart, { word: found.word, name });
    field.value = next.text;
    field.setSelectionRange(next.place, next.place);
    close();
    onTake();
  }

  const close = () => show({ word: "", names: [] });

  field.addEventListener("input", () => show(completionsOf(field.value, field.selectionStart, own())));
  field.addEventListener("blur", close);
  field.addEventListener("keydown", (event) => {
    if (list.hidden) return;
    if (event.key === "ArrowDown") choose(chosen + 1);
    else if (event.key === "ArrowUp") choose(chosen < 0 ? -1 : chosen - 1);
    else if (event.key === "Escape") close();
    else if (event.key === "Enter" && chosen >= 0) take(found.names[chosen]);
    else return;
    event.preventDefault();
    event.stopImmediatePropagation();
  });
  return { list, close };
}
