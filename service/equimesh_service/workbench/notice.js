// What keeps the page from showing the mesh, over the figure, so that nothing moves: a sentence, how far it is, buttons.

import { element } from "./dom.js";

// Who may say something; of several the first one is heard.
const ORDER = ["service", "problem", "link", "domain"];

/**
 * The notice over the figure.
 *
 * `tell(source, notice)` shows `{text, done, of, actions}` of one of the sources in `ORDER`; null takes it back.
 * `done` of `of` is a bar of progress; `actions` are `{text, act}`, each a button.
 *
 * @param {HTMLElement} place
 * @returns {{tell: (source: string, notice: object | null) => void}}
 */
export function createNotice(place) {
  const notices = new Map();
  const text = element("p", {});
  const bar = element("progress", { "aria-label": "Progress" });
  const row = element("div", { class: "row" });
  place.append(text, bar, row);
  let found = null;

  // Buttons stay where they are the same, so that one which is pressed or has the focus is not replaced.
  function showActions(actions) {
    const labels = actions.map((action) => action.text);
    if (labels.join("\n") === [...row.children].map((button) => button.textContent).join("\n")) return;
    const hadFocus = row.contains(document.activeElement);
    row.replaceChildren(...labels.map((label, k) => element("button", { type: "button", onclick: () => found?.actions[k]?.act() }, label)));
    if (hadFocus) row.querySelector("button")?.focus();
  }

  return {
    tell(source, notice) {
      if (notice) notices.set(source, notice);
      else notices.delete(source);
      found = notices.get(ORDER.find((one) => notices.has(one))) ?? null;
      place.hidden = !found;
      const { done = 0, of = 0, actions = [] } = found ?? {};
      if (text.textContent !== (found?.text ?? "")) text.textContent = found?.text ?? "";
      bar.hidden = !(of > 0);
      if (of > 0) Object.assign(bar, { max: of, value: done });
      row.hidden = !actions.length;
      showActions(actions);
    },
  };
}

/**
 * What to say while the service cannot answer, as `{text, done, of}`.
 *
 * @param {object} problem of the answer; its status is 0 where there was none
 * @param {object | null} readiness the body of `/readyz`, where the service answers
 */
export function waitingOf(problem, readiness) {
  if (problem.status === 0) return { text: "The service does not answer. The page tries again until it does." };
  if (readiness?.status === "ok") return null; // it computes, and still compiles loops of rare kinds of problems
  const { compiled = 0, of = 0 } = readiness?.warm_up ?? {};
  if (of > 0) {
    return { text: `The service warms up: it compiles its loops, once in an environment. ${compiled} of ${of} are done.`, done: compiled, of };
  }
  if (readiness?.warm_up) return { text: "The service warms up: it loads its loops. That takes some seconds." };
  return null;
}
