// The renderer without WebGL: paths on a canvas, one for each of the colours.

import { colourAt } from "./colours.js";
import { blended } from "./nodes.js";

// Colours that are told apart; cells of one colour are one path.
const SHADES = 64;
// Lines are left out where cells are smaller than this many pixels on average.
const SMALLEST_CELL = 2;

/**
 * See `createRenderer`.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {CanvasRenderingContext2D} context
 */
export function createPlainRenderer(canvas, context) {
  let mesh = null;
  let colours = null;

  function draw(panes, camera, { ratio, lines, ink }) {
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (!mesh || !colours) return { stride: 1, triangles: 0 };
    for (const pane of panes) {
      context.save();
      context.setTransform(ratio, 0, 0, ratio, ratio * pane.left, ratio * pane.top);
      context.beginPath();
      context.rect(0, 0, pane.width, pane.height);
      context.clip();
      const nodes = onPane(blended(mesh, pane.blend), camera, pane);
      fillCells(context, nodes, mesh.shape, shadesOf(colours, pane.blend, mesh.shape), colours.table);
      const cell = camera.scale * Math.sqrt(1 / (mesh.shape[0] * mesh.shape[1]));
      if (lines && cell > SMALLEST_CELL) strokeLines(context, nodes, mesh.shape, ink);
      context.restore();
    }
    return { stride: 1, triangles: 2 * panes.length * (mesh.shape[0] - 1) * (mesh.shape[1] - 1) };
  }

  return {
    kind: "2d",
    setNodes: (next) => (mesh = next),
    setColours: (next) => (colours = next),
    draw,
    finish: () => undefined,
  };
}

function onPane([x, y], camera, pane) {
  const [left, bottom] = [pane.width / 2 - camera.centre[0] * camera.scale, pane.height / 2 + camera.centre[1] * camera.scale];
  return [x.map((value) => left + value * camera.scale), y.map((value) => bottom - value * camera.scale)];
}

// The number of a shade for each cell; of values at nodes the mean of its corners.
function shadesOf({ places, uniformPlaces, isFlat }, blend, [n, m]) {
  const shades = new Uint8Array((n - 1) * (m - 1));
  const at = (k) => (1 - blend) * uniformPlaces[k] + blend * places[k];
  for (let i = 0; i < n - 1; i += 1) {
    for (let j = 0; j < m - 1; j += 1) {
      const k = i * m + j;
      const place = isFlat ? at(k) : (at(k) + at(k + 1) + at(k + m) + at(k + m + 1)) / 4;
      shades[i * (m - 1) + j] = Math.round(Math.min(1, Math.max(0, place)) * 255);
    }
  }
  return shades;
}

function fillCells(context, [x, y], [, m], shades, table) {
  const groups = new Map();
  for (let c = 0; c < shades.length; c += 1) {
    const shade = shades[c] < 16 ? shades[c] : Math.round((shades[c] / 255) * SHADES) * (255 / SHADES);
    if (!groups.has(shade)) groups.set(shade, []);
    groups.get(shade).push(c);
  }
  for (const [shade, cells] of groups) {
    context.beginPath();
    for (const c of cells) {
      const k = Math.floor(c / (m - 1)) * m + (c % (m - 1));
      context.moveTo(x[k], y[k]);
      for (const corner of [k + m, k + m + 1, k + 1]) context.lineTo(x[corner], y[corner]);
      context.closePath();
    }
    const colour = colourAt(table, shade / 255);
    context.fillStyle = colour;
    context.strokeStyle = colour;
    context.lineWidth = 0.6; // closes the seams between cells
    context.fill();
    context.stroke();
  }
}

function strokeLines(context, [x, y], [n, m], ink) {
  context.beginPath();
  for (let i = 0; i < n; i += 1) {
    context.moveTo(x[i * m], y[i * m]);
    for (let j = 1; j < m; j += 1) context.lineTo(x[i * m + j], y[i * m + j]);
  }
  for (let j = 0; j < m; j += 1) {
    context.moveTo(x[j], y[j]);
    for (let i = 1; i < n; i += 1) context.lineTo(x[i * m + j], y[i * m + j]);
  }
  const [red, green, blue] = (ink ?? [0.5, 0.5, 0.5]).map((value) => Math.round(255 * value));
  context.strokeStyle = `rgba(${red}, ${green}, ${blue}, 0.5)`;
  context.lineWidth = 0.7;
  context.stroke();
}
