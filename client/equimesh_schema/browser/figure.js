// The figure that moves under the reader's hand: a formula with sliders, and both meshes coloured by their error.
//
// It needs no service.  It keeps to the colours and the type of the page around it, and sets no style in attributes,
// so that strict policies allow it.

import { colourAt, legendOf, scaleOf, tableOf } from "./colours.js";
import { FormulaError } from "./kernel.js";
import { METHODS, createWork } from "./work.js";

/** Points along the shorter direction that the reader can choose. */
export const POINTS = [33, 65];
const SHADES = 64;
const STEPS = 200;
// The value and the ends of a slider of a name that was just made a parameter.
const NEW = { value: 1, min: 0, max: 10 };
// A domain that is this many times wider than high has its meshes below each other.
const WIDE = 1.6;

const amount = (value) => (value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e5) ? value.toExponential(2).replace("e+", "e") : String(Number(value.toPrecision(3))));

/** An element with attributes, listeners as `onclick`, and children. */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true || value === false) made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

let numbered = 0;
const fresh = (word) => `mesh-figure-${word}-${(numbered += 1)}`;

/** The number of points of a grid whose shorter direction has `points`, for the shape of a problem's grid. */
export function shapeOf({ grid: { n_xi: n = 33, n_eta: m = 33 } = {} }, points) {
  const least = Math.min(n, m) - 1;
  return [n, m].map((count) => Math.min(129, Math.round(((count - 1) * (points - 1)) / least) + 1));
}

/** What is asked, from a problem of the gallery: the formula, parameters with their ranges, and the domain. */
export function stateOf({ spec, sliders = {}, time }, { method = "least_error", points = POINTS[0] } = {}) {
  const { expression, parameters = {}, t } = spec.monitor.u;
  const values = { ...parameters, ...(t === undefined ? {} : { t }) };
  const given = { ...sliders, ...(time ? { t: time } : {}) };
  const ranges = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, given[name] ?? rangeOf(value)]));
  return { formula: expression, parameters: values, ranges, domain: spec.domain ?? null, shape: shapeOf(spec, points), method };
}

const rangeOf = (value) => (value === 0 ? { min: -1, max: 1 } : { min: Math.min(0, 4 * value), max: Math.max(0, 4 * value) });

/** What a preview says, in a sentence. */
export function sentenceOf({ gain, shape: [n, m] }, { isLast = true, isConverged } = {}) {
  const points = `${n} × ${m} points`;
  const than = `than on the uniform mesh, with the same ${points}.`;
  const found = gain >= 1.005 ? `The interpolation error is ${amount(gain)} times smaller ${than}` : gain <= 0.995 ? `The interpolation error is ${amount(1 / gain)} times larger ${than}` : `The interpolation error is that of the uniform mesh of ${points}.`;
  return isLast && isConverged === false ? `${found} The equations have no solution here that the page finds.` : found;
}

/**
 * Draw a mesh on a canvas, its cells coloured by their error.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {{x: ArrayLike<number>, y: ArrayLike<number>, error: ArrayLike<number>}} mesh
 * @param {number[]} shape
 * @param {{place: (value: number) => number}} scale
 * @param {boolean} isDark
 */
export function drawMesh(canvas, { x, y, error }, [n, m], scale, isDark) {
  const least = (values) => values.reduce((p, q) => Math.min(p, q), Infinity);
  const most = (values) => values.reduce((p, q) => Math.max(p, q), -Infinity);
  const [left, right, bottom, top] = [least(x), most(x), least(y), most(y)];
  const width = Math.max(1, Math.round(canvas.clientWidth * Math.min(2, devicePixelRatio || 1)));
  const height = Math.max(1, Math.round((width * (top - bottom)) / (right - left)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, width, height);
  const px = Float64Array.from(x, (one) => ((one - left) / (right - left)) * (width - 2) + 1);
  const py = Float64Array.from(y, (one) => ((top - one) / (top - bottom)) * (height - 2) + 1);
  const paths = Array.from({ length: SHADES + 1 }, () => null);
  for (let i = 0, c = 0; i < n - 1; i += 1) for (let j = 0; j < m - 1; j += 1, c += 1) {
    const path = (paths[Math.round(Math.min(1, scale.place(error[c]) || 0) * SHADES)] ??= new Path2D());
    const [a, b, d, e] = [i * m + j, (i + 1) * m + j, (i + 1) * m + j + 1, i * m + j + 1];
    path.moveTo(px[a], py[a]);
    for (const k of [b, d, e]) path.lineTo(px[k], py[k]);
    path.closePath();
  }
  const table = tableOf("error", isDark);
  paths.forEach((path, shade) => {
    if (!path) return;
    context.fillStyle = context.strokeStyle = colourAt(table, shade / SHADES);
    context.fill(path);
    context.stroke(path); // closes the seams between cells
  });
  const lines = new Path2D();
  for (let i = 0; i < n; i += 1) for (let j = 0; j < m; j += 1) lines[j ? "lineTo" : "moveTo"](px[i * m + j], py[i * m + j]);
  for (let j = 0; j < m; j += 1) for (let i = 0; i < n; i += 1) lines[i ? "lineTo" : "moveTo"](px[i * m + j], py[i * m + j]);
  context.strokeStyle = "rgba(128, 128, 128, 0.55)";
  context.stroke(lines);
}

// Whether text is light here, whatever sets the colours of the page.
function isDarkAt(place) {
  const [red, green, blue] = getComputedStyle(place).color.match(/[\d.]+/g).map(Number);
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue > 140;
}

/**
 * A figure in an element: `{ask(state), end()}`.
 *
 * `problems` are those of a list to choose from, of which the first is shown, as in the gallery.  `onChange(state)` is
 * called when the reader changes something, `onMesh(preview, state)` with the last mesh of each state.
 *
 * @param {HTMLElement} root
 * @param {{problems?: object[], state?: object, onChange?: Function, onMesh?: Function}} options
 */
export function createFigure(root, { problems = [], state: first = null, onChange = () => {}, onMesh = () => {} }) {
  let state = first ?? stateOf(problems[0]);
  let shown = null;
  const text = element("input", { type: "text", id: fresh("formula"), spellcheck: "false", autocapitalize: "off", autocomplete: "off" });
  const chooser = element("select", { id: fresh("problem") }, ...problems.map(({ title }, k) => element("option", { value: k }, title)));
  const sliders = element("div", { class: "mesh-figure-sliders", role: "group", "aria-label": "Parameters" });
  const fault = element("p", { class: "mesh-figure-fault", role: "alert", id: fresh("fault"), hidden: true });
  const answer = element("p", { class: "mesh-figure-answer", role: "status" });
  const panes = ["uniform", "adapted"].map((name) => {
    const caption = element("figcaption", {}, name);
    const canvas = element("canvas", { role: "img", "aria-label": `the ${name} mesh, coloured by its error` });
    return { name, canvas, caption, box: element("figure", {}, canvas, caption) };
  });
  const pair = element("div", { class: "mesh-figure-pair" }, ...panes.map(({ box }) => box));
  text.setAttribute("aria-describedby", fault.id);

  const work = createWork({
    show(preview, isLast, isConverged) {
      const [method] = METHODS[state.method];
      shown = preview;
      draw();
      text.removeAttribute("aria-invalid");
      fault.hidden = true;
      root.dataset.state = isLast ? "settled" : "moving";
      root.dataset.gain = preview.gain;
      if (!isLast && answer.textContent) return;
      answer.textContent = sentenceOf(preview, { isLast, isConverged });
      panes[0].caption.textContent = `uniform, error ${amount(preview.l2Uniform)}`;
      panes[1].caption.textContent = `${method}, error ${amount(preview.l2)}`;
      if (isLast) onMesh(preview, state);
    },
    fail(error) {
      if (!(error instanceof FormulaError)) throw error;
      text.setAttribute("aria-invalid", "true");
      root.dataset.state = "fault";
      fault.replaceChildren(`${error.message}. `, ...(error.unknown ? [declaration(error.unknown)] : []));
      fault.hidden = false;
    },
  });

  function declaration(name) {
    const act = () => change({ parameters: { ...state.parameters, [name]: NEW.value }, ranges: { ...state.ranges, [name]: NEW } });
    return element("button", { type: "button", onclick: act }, `Make ${name} a slider`);
  }

  function draw() {
    if (!shown || !root.isConnected) return; // Jupyter adds it to the page later, which the observer tells
    const scale = scaleOf("root", [shown.error, shown.uniformError]);
    const isDark = isDarkAt(root);
    drawMesh(panes[0].canvas, { x: shown.uniformX, y: shown.uniformY, error: shown.uniformError }, shown.shape, scale, isDark);
    drawMesh(panes[1].canvas, shown, shown.shape, scale, isDark);
    pair.classList.toggle("mesh-figure-wide", panes[0].canvas.width > WIDE * panes[0].canvas.height);
  }

  function change(part) {
    state = { ...state, ...part };
    write();
    onChange(state);
    root.dataset.state = "moving";
    work.ask(state);
  }

  // The controls as the state is; what is in the reader's hand stays.
  function write() {
    if (document.activeElement !== text || text.value !== state.formula) text.value = state.formula;
    const names = Object.keys(state.parameters);
    if (sliders.dataset.names !== names.join(" ")) sliders.replaceChildren(...names.map(slider));
    sliders.dataset.names = names.join(" ");
    names.forEach((name, k) => {
      const [, range, output] = sliders.children[k].children;
      const { min, max } = state.ranges[name] ?? rangeOf(state.parameters[name]);
      Object.assign(range, { min, max, step: (max - min) / STEPS });
      range.value = state.parameters[name];
      output.textContent = amount(state.parameters[name]);
    });
    for (const group of root.querySelectorAll("[data-choice]")) {
      const now = group.dataset.choice === "method" ? state.method : String(Math.min(...state.shape));
      for (const button of group.querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.value === now));
    }
  }

  function slider(name) {
    const id = fresh("slider");
    const move = (event) => change({ parameters: { ...state.parameters, [name]: Number(Number(event.target.value).toPrecision(4)) } });
    return element("div", {}, element("label", { for: id }, name), element("input", { type: "range", id, oninput: move }), element("output", { for: id }));
  }

  function choice(name, label, values) {
    const buttons = values.map(([value, words, act]) => element("button", { type: "button", value, onclick: act }, words));
    return element("div", { role: "group", "aria-label": label, "data-choice": name, class: "mesh-figure-choice" }, ...buttons);
  }

  // The same problem on another number of points.
  const scaled = (points) => shapeOf({ grid: { n_xi: state.shape[0], n_eta: state.shape[1] } }, points);
  text.addEventListener("input", () => change({ formula: text.value }));
  chooser.addEventListener("change", () => change(stateOf(problems[Number(chooser.value)], { method: state.method, points: Math.min(...state.shape) })));
  root.classList.add("mesh-figure");
  root.replaceChildren(
    ...(problems.length > 1 ? [element("div", { class: "mesh-figure-row" }, element("label", { for: chooser.id }, "Problem"), chooser)] : []),
    element("div", { class: "mesh-figure-row" }, element("label", { for: text.id }, "u(x, y) ="), text),
    fault,
    sliders,
    element("div", { class: "mesh-figure-row" },
      choice("method", "Method", Object.entries(METHODS).map(([value, [words]]) => [value, words, () => change({ method: value })])),
      choice("points", "Points", POINTS.map((points) => [points, `${points} points`, () => change({ shape: scaled(points) })]))),
    answer,
    pair,
    element("p", { class: "mesh-figure-legend" }, legendOf("error")),
  );
  write();
  work.ask(state);
  const observer = new ResizeObserver(draw);
  observer.observe(pair);
  const theme = new MutationObserver(draw);
  theme.observe(document.body, { attributes: true });
  const dark = matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", draw);

  return {
    /** Show another state, as if the reader had chosen it. */
    ask(next) {
      state = { ...state, ...next };
      write();
      work.ask(state);
    },
    end() {
      work.end();
      observer.disconnect();
      theme.disconnect();
      dark.removeEventListener("change", draw);
    },
  };
}
