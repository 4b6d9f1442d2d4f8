// The curve of a Schwarz iteration on a logarithmic axis, with its rates, and the same numbers as a table.

import { element } from "./dom.js";

// Digits above the line, for powers of ten.
const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
// The picture in its own units; it is scaled to the width of the page.
const WIDTH = 320;
const HEIGHT = 190;
// Room for the labels of the axes.
const LEFT = 38;
const RIGHT = 8;
const TOP = 8;
const BOTTOM = 28;
// How the lines of the rates are broken.
const DASHES = { observed: "1 5", predicted: "6 4" };
// A smaller predicted rate is not shown: then what the prediction leaves out decides.
const MIN_PREDICTED_RATE = 0.05;
// More points are a line without dots.
const MAX_DOTS = 40;
// The most labels of an axis.
const MAX_LABELS = 7;

/**
 * The numbers of a curve: errors against the single domain where they are known, else changes.
 *
 * @param {object | null} convergence as in GET /v1/meshes/{id}/convergence
 * @returns {{name: string, points: {iteration: number, value: number | null}[], rate: number | null,
 *   predicted: number | null}}
 */
export function curveOf(convergence) {
  const records = convergence?.iterations || [];
  const key = records.some((record) => record.error != null) ? "error" : "change";
  const predicted = convergence?.predicted_rate ?? null;
  return {
    name: key === "error" ? "error against the single domain" : "largest move of a node",
    points: records.map((record) => ({ iteration: record.iteration, value: record[key] ?? null })),
    rate: convergence?.rate ?? null,
    predicted: predicted !== null && predicted >= MIN_PREDICTED_RATE ? predicted : null,
  };
}

/**
 * A line of a constant rate. It begins at the first point, or goes through the middle of the last ones.
 *
 * @param {{iteration: number, value: number}[]} points positive values
 * @param {number} rate factor of one iteration
 * @param {boolean} isFitted whether the line goes through the middle of the last points
 * @returns {{iteration: number, value: number}[]} its two ends
 */
export function lineOf(points, rate, isFitted) {
  const [first, last] = [points[0], points[points.length - 1]];
  // The observed rate is the mean of at most six factors, those of the last seven points.
  const tail = isFitted ? points.slice(-7) : [first];
  const heights = tail.map(({ iteration, value }) => Math.log(value) - (iteration - first.iteration) * Math.log(rate));
  const start = heights.reduce((sum, one) => sum + one, 0) / heights.length;
  const at = (iteration) => ({ iteration, value: Math.exp(start + (iteration - first.iteration) * Math.log(rate)) });
  return [at(tail[0].iteration), at(last.iteration)];
}

/** The picture and the table of a curve. `draw` shows another curve, `mark` the present iteration. */
export class Curve {
  constructor() {
    this.picture = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", class: "curve" });
    this.rows = element("tbody", {});
    this.caption = element("caption", {}, "");
    const head = element("tr", {}, element("th", { scope: "col" }, "iteration"), element("th", { scope: "col" }, "value"));
    const table = element("table", {}, this.caption, element("thead", {}, head), this.rows);
    this.keys = element("ul", { class: "curve-keys", "aria-hidden": "true" });
    const details = element("details", {}, element("summary", {}, "The curve as a table"), element("div", { class: "curve-table", tabindex: "0", role: "region", "aria-label": "The curve as a table" }, table));
    this.element = element("div", {}, this.picture, this.keys, details);
    this.point = null;
  }

  /** Draw a curve; with the curve of a `rival`, a slower condition, both without the lines of their rates. */
  draw(curve, rival = null) {
    this.curve = curve;
    const points = curve.points.filter(({ value }) => value > 0);
    const others = rival ? rival.points.filter(({ value }) => value > 0) : [];
    const lines = [];
    if (rival) {
      this.scale = scaleOf({ points: [...curve.points, ...rival.points] }, [...points, ...others]);
      this.picture.replaceChildren(...this.axes(), ...this.line(others, "rival"), ...this.line(points));
      this.keys.replaceChildren(key("line", "optimized"), key("rival", "classical"));
      this.picture.setAttribute("aria-label", `Optimized: ${inWords(curve, points)} Classical: ${inWords(rival, others)}`);
      this.list(curve);
      return;
    }
    if (points.length > 1 && curve.rate > 0) lines.push({ kind: "observed", ends: lineOf(points, curve.rate, true) });
    if (points.length > 1 && curve.predicted) lines.push({ kind: "predicted", ends: lineOf(points, curve.predicted, false) });
    this.scale = scaleOf(curve, points);
    this.picture.replaceChildren(...this.axes(), ...lines.map((line) => this.rate(line)), ...this.line(points));
    this.keys.replaceChildren(key("line", curve.name), ...lines.map(({ kind }) => key(kind, `${kind} rate ${curve[kind === "observed" ? "rate" : "predicted"].toPrecision(2)}`)));
    this.picture.setAttribute("aria-label", inWords(curve, points));
    this.list(curve);
  }

  list(curve) {
    this.caption.textContent = `${curve.name} in each iteration`;
    this.rows.replaceChildren(...curve.points.map(({ iteration, value }) => element("tr", { "data-iteration": String(iteration) },
      element("th", { scope: "row" }, String(iteration)), element("td", {}, value === null ? "not known" : value.toExponential(2)))));
  }

  /** Mark an iteration in the picture and in the table. */
  mark(iteration) {
    const known = this.curve?.points.find((one) => one.iteration === iteration);
    this.point?.remove();
    if (!known) return;
    const { x, y } = this.scale;
    const value = known.value > 0 ? known.value : null;
    this.point = element("g", { class: "curve-mark" },
      element("line", { x1: x(iteration), x2: x(iteration), y1: TOP, y2: HEIGHT - BOTTOM, stroke: "currentColor", "stroke-dasharray": "2 3", "stroke-opacity": "0.6" }),
      ...(value === null ? [] : [element("circle", { cx: x(iteration), cy: y(value), r: 5, fill: "currentColor" })]));
    this.picture.append(this.point);
    for (const row of this.rows.children) {
      if (row.dataset.iteration === String(iteration)) row.setAttribute("aria-current", "true");
      else row.removeAttribute("aria-current");
    }
  }

  line(points, kind = "line") {
    const { x, y } = this.scale;
    const places = points.map(({ iteration, value }) => `${x(iteration)},${y(value)}`);
    const dots = places.length > MAX_DOTS ? [] : places.map((place) => element("circle", { cx: place.split(",")[0], cy: place.split(",")[1], r: 2.4, class: kind === "line" ? "curve-dot" : "curve-rival-dot" }));
    return [element("polyline", { points: places.join(" "), fill: "none", class: `curve-${kind}` }), ...dots];
  }

  rate({ kind, ends }) {
    const { x, y } = this.scale;
    const [from, to] = ends;
    return element("line", { x1: x(from.iteration), y1: y(from.value), x2: x(to.iteration), y2: y(to.value), class: `curve-${kind}`, "stroke-dasharray": DASHES[kind] });
  }

  axes() {
    const { x, y, last, powers } = this.scale;
    const bottom = HEIGHT - BOTTOM;
    const parts = [];
    for (const power of powers) {
      const at = y(10 ** power);
      parts.push(element("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: at, y2: at, stroke: "currentColor", "stroke-opacity": "0.18" }));
      parts.push(label(LEFT - 5, at + 4, "end", powerOfTen(power)));
    }
    const step = Math.max(1, Math.ceil(last / MAX_LABELS));
    for (let iteration = 0; iteration <= last; iteration += step) {
      parts.push(label(x(iteration), bottom + 13, "middle", String(iteration)));
    }
    parts.push(label((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 2, "middle", "iteration"));
    return parts;
  }
}

// The places of iterations and values in the picture.
function scaleOf(curve, points) {
  const last = Math.max(1, ...curve.points.map(({ iteration }) => iteration));
  const logs = points.map(({ value }) => Math.log10(value));
  const low = logs.length ? Math.floor(Math.min(...logs)) : -1;
  const high = logs.length ? Math.max(Math.ceil(Math.max(...logs)), low + 1) : 0;
  const step = Math.max(1, Math.ceil((high - low) / MAX_LABELS));
  const powers = [];
  for (let power = high; power >= low; power -= step) powers.push(power);
  const height = HEIGHT - TOP - BOTTOM;
  const rounded = (number) => Math.round(number * 100) / 100;
  return {
    last,
    powers,
    x: (iteration) => rounded(LEFT + (iteration / last) * (WIDTH - LEFT - RIGHT)),
    // Lines of a rate that leave the picture end at its edges.
    y: (value) => rounded(TOP + Math.min(1, Math.max(0, (high - Math.log10(value)) / (high - low))) * height),
  };
}

function inWords(curve, points) {
  if (!points.length) return "No iteration has a known value.";
  const [first, last] = [points[0], points[points.length - 1]];
  const rates = [curve.rate > 0 ? `Observed rate ${curve.rate.toPrecision(2)}.` : "", curve.predicted ? `Predicted rate ${curve.predicted.toPrecision(2)}.` : ""];
  const way = `${first.value.toExponential(1)} in iteration ${first.iteration}, ${last.value.toExponential(1)} in iteration ${last.iteration}`;
  return [`Convergence curve. The ${curve.name}: ${way}.`, ...rates].filter(Boolean).join(" ");
}

function key(kind, text) {
  const sample = element("line", { x1: 0, x2: 26, y1: 5, y2: 5, class: `curve-${kind}`, "stroke-dasharray": DASHES[kind] ?? null });
  return element("li", {}, element("svg", { viewBox: "0 0 26 10" }, sample), text);
}

function label(x, y, anchor, text) {
  return element("text", { x, y, "text-anchor": anchor, "font-size": 10, fill: "currentColor" }, text);
}

function powerOfTen(power) {
  return `10${[...String(power)].map((digit) => RAISED[digit]).join("")}`;
}
