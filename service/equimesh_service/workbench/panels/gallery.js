// The gallery: problems that people know, each a click away.

import { colourAt, tableOf } from "../browser/colours.js";
import { element } from "../dom.js";

const FILES = { problems: "workbench/gallery.json", pictures: "workbench/gallery_pictures.json" };
// Pixels of a picture in the layout; it is drawn for a screen of twice as many.
const WIDTH = 80;
const HEIGHT = 60;
const SHARPNESS = 2;
// Milliseconds after which the gallery no longer waits for the first mesh.
const LATEST = 2000;
// The largest digit of u in a picture.
const SHADES = 9;

/**
 * The panel of the gallery.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const list = element("div", { class: "gallery", role: "group", "aria-label": "Problems" });
  const sentence = element("p", { class: "hint" }, "Fourteen problems that people know. Choose one, then change it.");
  section.append(list, sentence);
  let problems = [];

  function mark() {
    const { spec } = app.store.get();
    const shown = problems.find((problem) => isShown(problem, spec));
    [...list.children].forEach((button, k) => button.setAttribute("aria-pressed", String(problems[k] === shown)));
    if (shown) sentence.textContent = shown.sentence;
  }

  async function load() {
    try {
      ({ problems } = await app.service.json(FILES.problems));
    } catch (error) {
      sentence.textContent = `The gallery cannot be loaded. ${error.message}`;
      return;
    }
    list.replaceChildren(...problems.map((problem) => buttonOf(problem, list, app)));
    app.store.subscribe((state, before) => state.spec !== before.spec && mark());
    mark();
    const pictures = await app.service.json(FILES.pictures).catch(() => ({})); // titles are enough
    const draw = () => problems.forEach(({ name }, k) => pictures[name] && drawOn(list.children[k].querySelector("canvas"), pictures[name]));
    draw();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }

  // The first mesh of the page comes first, but a busy service does not keep the gallery away.
  const ends = [];
  const begin = () => {
    if (!ends.length) return;
    ends.splice(0).forEach((end) => end());
    load();
  };
  const timer = setTimeout(begin, LATEST);
  ends.push(() => clearTimeout(timer), app.on("drawing", begin), app.on("problem", (problem) => problem && begin()));
}

function buttonOf(problem, list, app) {
  const canvas = element("canvas", { width: WIDTH * SHARPNESS, height: HEIGHT * SHARPNESS, "aria-hidden": "true" });
  const choose = () => {
    app.change({ spec: problem.spec, sliders: slidersOf(problem), samples: null });
    app.announce(`${problem.title}. ${problem.sentence}`);
    // On a phone the mesh is far above the gallery.
    const isBelow = app.canvas.stage.getBoundingClientRect().bottom < list.getBoundingClientRect().top;
    document.querySelector("#headline").scrollIntoView({ block: isBelow ? "start" : "nearest" });
  };
  return element("button", { type: "button", title: problem.sentence, "data-name": problem.name, onclick: choose }, canvas, element("span", {}, problem.title));
}

// A moving problem has the range of its time among the sliders.
function slidersOf({ sliders, time }) {
  return time ? { ...sliders, t: time } : sliders;
}

// Another value of a slider is still the same problem.
function isShown(problem, spec) {
  const u = spec.monitor?.u;
  return u?.expression === problem.spec.monitor.u.expression && JSON.stringify(spec.domain) === JSON.stringify(problem.spec.domain);
}

// Cells in the colours of u, and the lines of the mesh, of its grid or block by block.
function drawOn(canvas, { size: [width, height], blocks, ...grid }) {
  const context = canvas.getContext("2d");
  const scale = Math.min(canvas.width / width, canvas.height / height);
  const origin = [(canvas.width - scale * width) / 2, (canvas.height - scale * height) / 2];
  context.clearRect(0, 0, canvas.width, canvas.height);
  for (const part of blocks ?? [grid]) drawPart(context, part, scale, origin);
}

function drawPart(context, { shape: [n, m], nodes, u }, scale, [left, top]) {
  const isDark = matchMedia("(prefers-color-scheme: dark)").matches;
  const table = tableOf("u", isDark);
  const at = (node) => [left + scale * nodes[2 * node], top + scale * nodes[2 * node + 1]];
  const shade = (node) => Number(u[node]);
  for (let i = 0; i < n - 1; i += 1) {
    for (let j = 0; j < m - 1; j += 1) {
      const node = i * m + j;
      const corners = [node, node + m, node + m + 1, node + 1];
      context.fillStyle = colourAt(table, corners.reduce((sum, one) => sum + shade(one), 0) / (4 * SHADES));
      trace(context, corners.map(at));
      context.fill();
    }
  }
  context.strokeStyle = isDark ? "rgb(0 0 0 / 45%)" : "rgb(255 255 255 / 55%)";
  for (let i = 0; i < n; i += 1) line(context, Array.from({ length: m }, (_, j) => at(i * m + j)));
  for (let j = 0; j < m; j += 1) line(context, Array.from({ length: n }, (_, i) => at(i * m + j)));
}

function trace(context, points) {
  context.beginPath();
  points.forEach(([x, y]) => context.lineTo(x, y));
  context.closePath();
}

function line(context, points) {
  context.beginPath();
  points.forEach(([x, y]) => context.lineTo(x, y));
  context.stroke();
}
