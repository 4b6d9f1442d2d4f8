// The numbers of one cell: of that under the pointer, or of that to which the arrow keys went.

import { element } from "../dom.js";
import { amount } from "../words.js";
import { areaOf, blended, cellAt, cornersBetween, cornersOf } from "./nodes.js";

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
// Cells that an arrow key with Shift goes.
const STRIDE = 8;

/**
 * Show the numbers of the cell under the pointer, or of the one that the keys have reached.
 *
 * @param {object} self the stage
 * @param {object} app
 */
export function followCells(self, app) {
  const { stage, overlay } = self;
  const tip = stage.querySelector("#tip");
  const marks = element("g", {});
  overlay.append(marks);
  let cell = null;
  let pane = null; // the pane under the pointer; null while keys move

  function show() {
    const mesh = self.mesh;
    tip.hidden = !cell || !mesh;
    marks.replaceChildren();
    if (tip.hidden) return;
    cell = heldIn(mesh, cell);
    for (const [k, each] of self.panes.entries()) {
      const corners = cornersBetween(mesh, each.blend, cell).map((point) => self.toPane(point, k));
      const points = corners.map((corner) => corner.join(",")).join(" ");
      marks.append(element("polygon", { points, class: "halo" }), element("polygon", { points, class: "cell" }));
    }
    tip.textContent = textOf(app.drawing, mesh, cell, pane ?? self.panes.at(-1));
    place();
  }

  function place() {
    const number = pane ? self.panes.indexOf(pane) : self.panes.length - 1;
    const k = Math.max(0, number);
    const corners = cornersBetween(self.mesh, self.panes[k].blend, cell);
    const pixels = corners.map((point) => self.toPane(point, k));
    const [right, left] = [Math.max(...pixels.map(([x]) => x)), Math.min(...pixels.map(([x]) => x))];
    const top = Math.min(...pixels.map(([, y]) => y));
    const fits = right + 12 + tip.offsetWidth < stage.clientWidth;
    tip.style.left = `${Math.max(4, fits ? right + 12 : left - 12 - tip.offsetWidth)}px`;
    tip.style.top = `${Math.max(4, Math.min(stage.clientHeight - tip.offsetHeight - 4, top))}px`;
  }

  stage.addEventListener("pointermove", (event) => {
    if (event.buttons || !self.mesh || !self.panes.length) return;
    const bounds = stage.getBoundingClientRect();
    const pixel = [event.clientX - bounds.left - stage.clientLeft, event.clientY - bounds.top - stage.clientTop];
    const [found, inside] = self.paneAt(pixel);
    const next = cellAt(blended(self.mesh, found.blend), self.mesh, self.camera.toDomain(inside));
    if (String(next) === String(cell) && found === pane) return;
    [cell, pane] = [next, found];
    show();
  });
  stage.addEventListener("pointerleave", () => {
    cell = null;
    show();
  });
  stage.addEventListener("blur", () => {
    cell = null;
    show();
  });
  stage.addEventListener("keydown", (event) => {
    const arrow = ARROWS[event.key];
    if (!self.mesh || (!arrow && event.key !== "Escape")) return;
    event.preventDefault();
    pane = null;
    const start = [0, ...self.mesh.blocks[0].shape.map((number) => Math.floor(number / 2) - 1)];
    const stride = event.shiftKey ? STRIDE : 1;
    cell = arrow ? (cell ? cell.map((number, k) => (k === 0 ? number : number + stride * arrow[k - 1])) : start) : null;
    show();
    if (cell) app.announce(tip.textContent.replaceAll("\n", ", "));
  });
  self.on(() => cell && show());
}

// The nearest place in the mesh, which may be another one by now.  Behind the last column of a block comes the next block.
function heldIn(mesh, [b, i, j]) {
  let block = Math.min(mesh.blocks.length - 1, b);
  let first = i;
  while (first > mesh.blocks[block].shape[0] - 2 && block < mesh.blocks.length - 1) {
    first -= mesh.blocks[block].shape[0] - 1;
    block += 1;
  }
  while (first < 0 && block > 0) {
    block -= 1;
    first += mesh.blocks[block].shape[0] - 1;
  }
  const [n, m] = mesh.blocks[block].shape;
  return [block, Math.min(n - 2, Math.max(0, first)), Math.min(m - 2, Math.max(0, j))];
}

function textOf({ arrays }, mesh, place, { blend }) {
  const corners = cornersBetween(mesh, blend, place);
  const middle = [0, 1].map((k) => corners.reduce((sum, corner) => sum + corner[k], 0) / 4);
  const isUniform = blend < 0.5;
  const of = (name) => arrays[isUniform ? `uniform_${name}` : name]?.data;
  const size = Math.sqrt(areaOf(corners));
  const [b, i, j] = place;
  const { name } = mesh.blocks[b];
  const lines = [`${name && `${name}, `}cell ${i + 1}, ${j + 1} at (${amount(middle[0])}, ${amount(middle[1])})`, `size ${amount(size)}`];
  const { corners: nodes, number } = cornersOf(mesh, place);
  const u = of("u");
  if (u) lines.push(`u ${amount(nodes.reduce((sum, node) => sum + u[node], 0) / 4)}`);
  if (of("error")) lines.push(`error ${amount(of("error")[number])}`);
  if (of("q_eq")) lines.push(`Q_eq ${amount(of("q_eq")[number])}`);
  return lines.join("\n");
}
