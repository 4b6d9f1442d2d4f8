// How the mesh is looked at: colours with their legend, uniform or adapted, zoom, and pictures of what is seen.

import { COLOURS, legendOf } from "../browser/colours.js";
import { isThere } from "../drawing/values.js";
import { element, freshId, select } from "../dom.js";
import { hasBlocks } from "../sides.js";
import { amount } from "../words.js";

// Milliseconds in which the nodes go from the uniform to the adapted mesh.
const JOURNEY = 1400;
// Milliseconds without a movement of the slider until its place is part of the state.
const SETTLED = 120;

/**
 * The panel of the view.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const { store, canvas } = app;
  const setView = (view) => store.update({ view });
  const choices = Object.entries(COLOURS).map(([value, { text }]) => ({ value, text }));
  const colour = select(choices, store.get().view.colour, (value) => setView({ colour: value }));
  colour.id = freshId("colour");
  const lines = element("input", { type: "checkbox", id: freshId("lines"), onchange: () => setView({ lines: lines.checked }) });
  const pair = element("button", { type: "button", onclick: () => setView({ layout: "pair" }) }, "both meshes");
  const single = element("button", { type: "button", onclick: () => setView({ layout: "single" }) }, "one mesh");
  const legend = createLegend(app);
  section.append(
    element(
      "div",
      { class: "view" },
      element("div", { class: "row" }, element("label", { for: colour.id }, "Colour by"), colour),
      legend.node,
      element(
        "div",
        { class: "row" },
        element("span", { class: "group", role: "group", "aria-label": "Layout" }, pair, single),
        element("label", { for: lines.id, class: "row" }, lines, "lines"),
      ),
      element("div", { class: "row wide" }, createBlend(app, setView), zoomButtons(canvas)),
    ),
  );

  function show({ view }) {
    colour.value = view.colour;
    lines.checked = view.lines;
    pair.setAttribute("aria-pressed", String(view.layout === "pair"));
    single.setAttribute("aria-pressed", String(view.layout !== "pair"));
    legend.show();
  }

  app.on("drawing", (drawing) => {
    for (const option of colour.options) option.disabled = !isThere(drawing, option.value);
    legend.show();
  });
  store.subscribe(show);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => legend.show());
  show(store.get());
}

function createLegend(app) {
  const bar = element("canvas", { width: 256, height: 1, "aria-hidden": "true" });
  const [low, middle, high] = [0, 1, 2].map(() => element("span"));
  const what = element("span");
  const node = element("div", { class: "legend" }, what, bar, element("div", { class: "ends" }, low, middle, high));

  let shown = null; // each colour and each drawing has a table of its own

  function show() {
    const { coloured, table } = app.canvas;
    if (!coloured || !table || table === shown) return;
    shown = table;
    const { name, scale } = coloured;
    const isContinuous = Boolean(COLOURS[name].map);
    const isOneValue = isContinuous && scale.low === scale.high;
    bar.hidden = !isContinuous;
    what.textContent = legendOf(name);
    const ends = isContinuous ? [scale.low, isOneValue ? null : scale.middle, isOneValue ? null : scale.high].map((value) => (value === null ? "" : amount(value))) : ["", "", ""];
    [low, middle, high].forEach((each, k) => (each.textContent = ends[k]));
    bar.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(table), 256, 1), 0, 0);
  }
  return { node, show };
}

// The slider between both meshes, and a button that lets the nodes go.
function createBlend(app, setView) {
  const { store, canvas } = app;
  const id = freshId("blend");
  const slider = element("input", { type: "range", id, min: 0, max: 1, step: 0.01 });
  const label = element("label", { for: id });
  const play = element("button", { type: "button", onclick: () => travel() }, "Move the nodes");
  let journey = 0;
  let settling = 0;

  // The state, and with it the address and all panels, is told once the slider rests.
  function drag(blend) {
    cancelAnimationFrame(journey);
    canvas.journey = blend;
    canvas.move();
    clearTimeout(settling);
    settling = setTimeout(() => stop(blend), SETTLED);
  }

  function travel() {
    clearTimeout(settling);
    cancelAnimationFrame(journey);
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
      setView({ blend: store.get().view.blend < 0.5 ? 1 : 0 });
      return;
    }
    const began = performance.now();
    const step = (now) => {
      const share = Math.min(1, Math.max(0, (now - began) / JOURNEY));
      canvas.journey = share * share * (3 - 2 * share);
      slider.value = canvas.journey;
      canvas.move();
      if (share < 1) journey = requestAnimationFrame(step);
      else stop(1);
    };
    journey = requestAnimationFrame(step);
  }

  function stop(blend) {
    cancelAnimationFrame(journey);
    clearTimeout(settling);
    canvas.journey = null;
    setView({ blend });
  }

  function show({ view, spec }) {
    label.textContent = hasBlocks(spec?.domain) ? "initial" : "uniform";
    slider.value = view.blend;
    slider.setAttribute("aria-valuetext", `${Math.round(100 * view.blend)} % of the way to the adapted mesh`);
  }
  slider.addEventListener("input", () => drag(Number(slider.value)));
  slider.addEventListener("change", () => stop(Number(slider.value)));
  store.subscribe(show);
  show(store.get());
  return element(
    "div",
    { class: "blend" },
    label,
    slider,
    element("span", { "aria-hidden": "true" }, "adapted"),
    play,
  );
}

function zoomButtons(canvas) {
  const button = (text, label, onclick) => element("button", { type: "button", "aria-label": label, onclick }, text);
  return element(
    "span",
    { class: "group zoom", role: "group", "aria-label": "Zoom" },
    button("+", "Zoom in", () => canvas.zoomBy(1.5)),
    button("−", "Zoom out", () => canvas.zoomBy(1 / 1.5)),
    button("whole", "Show the whole domain", () => canvas.reset()),
  );
}
