// The renderer without WebGL: paths on a canvas, one for each of the colours.

import { colourAt } from "../browser/colours.js";
import { blended, cellCount, eachCell, linesOf } from "./nodes.js";

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
      fillCells(context, nodes, mesh, shadesOf(colours, pane.blend, mesh), colours.table);
      const cell = camera.scale * Math.sqrt(1 / mesh.x.length);
      if (lines && cell > SMALLEST_CELL) strokeLines(context, nodes, mesh, ink);
      context.restore();
    }
    return { stride: 1, triangles: 2 * panes.length * cellCount(mesh) };
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
function shadesOf({ places, uniformPlaces, isFlat }, blend, mesh) {
  const shades = new Uint8Array(cellCount(mesh));
  const at = (k) => (1 - blend) * uniformPlaces[k] + blend * places[k];
  eachCell(mesh, ([a, b, c, d], cell) => {
    const place = isFlat ? at(a) : (at(a) + at(b) + at(c) + at(d)) / 4;
    shades[cell] = Math.round(Math.min(1, Math.max(0, place)) * 255);
  });
  return shades;
}

function fillCells(context, [x, y], mesh, shades, table) {
  const groups = new Map();
  eachCell(mesh, (corners, c) => {
    const shade = shades[c] < 16 ? shades[c] : Math.round((shades[c] / 255) * SHADES) * (255 / SHADES);
    if (!groups.has(shade)) groups.set(shade, []);
    groups.get(shade).push(corners);
  });
  for (const [shade, cells] of groups) {
    context.beginPath();
    for (const [first, ...others] of cells) {
      context.moveTo(x[first], y[first]);
      for (const corner of others) context.lineTo(x[corner], y[corner]);
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

function strokeLines(context, [x, y], mesh, ink) {
  context.beginPath();
  for (const [first, ...others] of linesOf(mesh)) {
    context.moveTo(x[first], y[first]);
    for (const node of others) context.lineTo(x[node], y[node]);
  }
  const [red, green, blue] = (ink ?? [0.5, 0.5, 0.5]).map((value) => Math.round(255 * value));
  context.strokeStyle = `rgba(${red}, ${green}, ${blue}, 0.5)`;
  context.lineWidth = 0.7;
  context.stroke();
}
