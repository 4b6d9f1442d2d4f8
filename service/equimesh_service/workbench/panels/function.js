// The function: its expression with a caret where it is wrong, and a slider for each parameter.

import { createCompletion } from "../completion.js";
import { element, freshId } from "../dom.js";
import { amount } from "../words.js";
import { replaced } from "../store.js";

const KNOWN = new Set(["x", "y", "pi", "e", "and", "or", "not"]);
const NUMBERS = /(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?/g;
const NAMES = /[A-Za-z_]\w*(?!\w*\s*\()/g;
const UNKNOWN = /'([A-Za-z_]\w*)' is not a known name/;
// The value and the ends of the slider of a parameter that was just added.
const FRESH = 1;
const FRESH_RANGE = { min: 0, max: 10 };
const SLIDER_STEPS = 400;
// Milliseconds after a key until the text is called wrong: before, a word may not be finished.
const FINISHED = 900;

/**
 * The path in the state of the source that the field edits: u, the density of a weight, or the first u of an
 * intersection; null for a tensor, which has three.
 *
 * @param {object} spec
 */
export function sourcePath(spec) {
  const { kind, monitors } = spec.monitor ?? {};
  if (kind === "tensor") return null;
  if (kind === "weight") return ["spec", "monitor", "rho"];
  return monitors ? ["spec", "monitor", "monitors", 0, "u"] : ["spec", "monitor", "u"];
}

/** The names in an expression that a parameter or t must give a value to, in their order. */
export function freeNames(text) {
  const names = text.replaceAll(NUMBERS, " ").match(NAMES) ?? [];
  return [...new Set(names.filter((name) => !KNOWN.has(name)))];
}

/**
 * The panel of the function.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const { store } = app;
  const remembered = new Map(); // values of parameters that the expression does not have at the moment
  const id = freshId("expression");
  const text = element("textarea", {
    id,
    rows: 1,
    spellcheck: "false",
    autocomplete: "off",
    autocapitalize: "off",
    placeholder: "a function of x and y, such as tanh(20*(x - y))",
    "aria-describedby": `${id}-fault`,
  });
  const label = element("label", { for: id }, "u(x, y) =");
  const caret = element("pre", { class: "caret", "aria-hidden": "true" });
  const fault = element("p", { class: "fault", id: `${id}-fault`, role: "alert" });
  const offer = element("p", { class: "offer" });
  const sliders = element("div", { class: "parameters", role: "group", "aria-label": "Parameters" });
  const understood = element("p", { class: "understood" });
  const completion = createCompletion(text, { own: () => Object.keys(source().parameters ?? {}), onTake: type, onShow: place });
  const below = element("div", { hidden: true }, caret, fault, offer, understood, completion.list);
  section.append(element("div", { class: "formula" }, label, text, element("div", { class: "below" }, below)), sliders);
  let typed = -Infinity; // when the last key was pressed
  let telling = 0;

  const path = () => sourcePath(store.get().spec);
  const source = () => sourceOf(store.get());

  function write(next) {
    store.update((state) => replaced(state, path(), next));
  }

  // What is told under the field lies over the page; where there is nothing to tell, there is nothing.
  function place() {
    const isTold = [fault, offer, understood].some((each) => each.textContent) || !completion.list.hidden;
    below.hidden = !isTold;
  }

  function type() {
    grow();
    typed = performance.now();
    clearTimeout(telling);
    tell(null);
    understood.textContent = "";
    const old = source();
    const names = freeNames(text.value);
    for (const [name, value] of Object.entries(old.parameters ?? {})) remembered.set(name, value);
    const kept = names.filter((name) => name !== "t" && (name in (old.parameters ?? {}) || remembered.has(name)));
    write(sourceWith(text.value, Object.fromEntries(kept.map((name) => [name, remembered.get(name)])), old.t));
  }

  function add(name) {
    const { expression, parameters, t } = source();
    remembered.set(name, FRESH);
    write(sourceWith(expression, { ...parameters, [name]: FRESH }, t));
    app.announce(`The parameter ${name} was added, with the value ${FRESH}.`);
  }

  function setValue(name, value) {
    const old = source();
    if (name === "t") write({ ...old, t: value });
    else write({ ...old, parameters: { ...old.parameters, [name]: value } });
  }

  function grow() {
    text.style.height = "auto";
    text.style.height = `${text.scrollHeight + 2}px`;
  }

  function showFault(problem) {
    clearTimeout(telling);
    const pointer = `/${path()?.slice(1).join("/")}/`;
    const found = (problem?.errors ?? []).find((each) => `${each.pointer}/`.startsWith(pointer)) ?? null;
    const pause = document.activeElement === text ? typed + FINISHED - performance.now() : 0;
    if (found && pause > 0) telling = setTimeout(() => tell(found), pause);
    else tell(found);
  }

  // What is wrong with the function: a fault of the service, or null.
  function tell(found) {
    if (fault.textContent !== (found?.message ?? "")) fault.textContent = found?.message ?? "";
    if (found) text.setAttribute("aria-invalid", "true");
    else text.removeAttribute("aria-invalid");
    const column = found?.position?.line === 1 ? found.position.column : 0;
    const isOneLine = text.scrollHeight < 60;
    caret.textContent = column && isOneLine ? `${" ".repeat(column - 1)}^` : "";
    const name = UNKNOWN.exec(found?.message ?? "")?.[1];
    offer.replaceChildren(
      ...(name ? [element("button", { type: "button", onclick: () => add(name) }, `Add ${name} as a parameter`)] : []),
    );
    place();
  }

  // The formula as the service has read it, where that is not what was typed.
  function showUnderstood({ document: facts, isIterate, isLocal }) {
    if (isIterate || isLocal || document.activeElement !== text) return;
    const read = facts.certificate?.understood?.[path()?.slice(1).join(".")];
    understood.replaceChildren(...(read ? ["understood as ", element("code", {}, read)] : []));
    place();
  }

  function show(state, before) {
    if (before && state.spec === before.spec && state.samples === before.samples && state.sliders === before.sliders) return;
    const { expression, parameters = {}, t = 0 } = sourceOf(state);
    const isText = expression !== undefined;
    label.textContent = state.spec.monitor?.kind === "weight" ? "ρ(x, y) =" : "u(x, y) =";
    text.disabled = !isText;
    if (document.activeElement !== text || text.value.trim() !== (expression ?? "").trim()) {
      text.value = isText ? expression : `from ${state.samples?.name ?? "samples"}`;
    }
    if (!before || state.spec !== before.spec || state.sliders !== before.sliders) {
      const values = isText && freeNames(expression).includes("t") ? { ...parameters, t } : parameters;
      showSliders(sliders, values, state.sliders, { store, setValue });
    }
    grow();
  }

  text.addEventListener("input", type);
  text.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    offer.querySelector("button")?.click();
  });
  app.on("problem", showFault);
  app.on("drawing", showUnderstood);
  text.addEventListener("blur", () => {
    understood.textContent = "";
    place();
  });
  store.subscribe(show);
  new ResizeObserver(grow).observe(section);
  show(store.get());
}

function sourceOf(state) {
  const path = sourcePath(state.spec);
  const source = path?.reduce((value, key) => value?.[key], state);
  return typeof source === "string" ? { expression: source } : (source ?? {});
}

// Only keys that differ from the defaults.
function sourceWith(expression, parameters, t) {
  const source = { expression };
  if (Object.keys(parameters).length) source.parameters = parameters;
  if (t !== undefined && freeNames(expression).includes("t")) source.t = t;
  return source;
}

// Rows are kept as long as the names are the same, so that a slider which is dragged stays in the hand.
function showSliders(place, values, ranges, { store, setValue }) {
  const names = Object.keys(values);
  if (place.dataset.names !== names.join(" ")) {
    place.dataset.names = names.join(" ");
    place.replaceChildren(...names.map((name) => rowOf(name, setValue)));
  }
  names.forEach((name, k) => {
    const [, slider, number] = place.children[k].children;
    const value = values[name];
    const { min, max } = rangeOf(name, value, ranges, store);
    if (Number(slider.min) !== min) slider.min = min;
    if (Number(slider.max) !== max) slider.max = max;
    slider.step = (max - min) / SLIDER_STEPS;
    if (document.activeElement !== slider) slider.value = value;
    if (document.activeElement !== number) number.value = value;
    slider.setAttribute("aria-valuetext", amount(value));
  });
}

function rowOf(name, setValue) {
  const slider = element("input", { type: "range", id: freshId("slider"), step: "any" });
  const number = element("input", { type: "number", step: "any", "aria-label": `value of ${name}` });
  slider.addEventListener("input", () => {
    setValue(name, Number(Number(slider.value).toPrecision(4)));
  });
  number.addEventListener("input", () => {
    if (number.value !== "" && Number.isFinite(number.valueAsNumber)) setValue(name, number.valueAsNumber);
  });
  return element("div", { class: "parameter" }, element("label", { for: slider.id }, name), slider, number);
}

// The ends of a slider: as they were set, but wide enough for the value.
function rangeOf(name, value, ranges, store) {
  const fallback = value >= 0 && value <= FRESH_RANGE.max ? FRESH_RANGE : { min: Math.min(0, 2 * value), max: Math.max(1, 2 * value) };
  const known = ranges[name] ?? (name === "t" ? { min: 0, max: 1 } : fallback);
  const range = { min: Math.min(known.min, value), max: Math.max(known.max, value) };
  const isKnown = ranges[name]?.min === range.min && ranges[name]?.max === range.max;
  // A value that is no number, as a link may have it, has no range; to store one would never end.
  if (!isKnown && Number.isFinite(range.min) && Number.isFinite(range.max)) {
    queueMicrotask(() => store.update((state) => ({ sliders: { ...state.sliders, [name]: range } })));
  }
  return range;
}
