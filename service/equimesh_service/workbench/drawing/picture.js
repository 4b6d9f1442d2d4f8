// Pictures of what is seen: SVG with a path for each colour, and PNG of the canvas.

import { colourAt } from "./colours.js";
import { blended, eachCell, linesOf } from "./nodes.js";
import { placesOf } from "./values.js";

// Colours of the cells of an SVG; cells of one colour are one path.
const SHADES = 96;

/**
 * The stage as an SVG picture, a Blob.
 *
 * @param {object} app
 */
export async function svgOf(app) {
  const { canvas: self, store } = app;
  self.drawNow();
  const { clientWidth: width, clientHeight: height } = self.stage;
  const parts = [
    `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}">`,
    `<rect width="${width}" height="${height}" fill="${getComputedStyle(self.stage).backgroundColor}"/>`,
  ];
  self.panes.forEach((pane, k) => {
    const clip = `<clipPath id="pane${k}"><rect x="${pane.left}" y="${pane.top}" width="${pane.width}" height="${pane.height}"/></clipPath>`;
    parts.push(clip, `<g clip-path="url(#pane${k})">`, ...cellsOf(self, pane, k));
    if (store.get().view.lines) parts.push(strokesOf(self, pane, k));
    parts.push("</g>");
  });
  parts.push("</svg>");
  return new Blob([parts.join("\n")], { type: "image/svg+xml" });
}

/**
 * The stage as a PNG picture, a Blob.
 *
 * @param {object} app
 */
export async function pngOf(app) {
  const { canvas: self } = app;
  self.drawNow();
  const source = self.stage.querySelector("canvas");
  const copy = new OffscreenCanvas(source.width, source.height);
  const context = copy.getContext("2d");
  context.fillStyle = getComputedStyle(self.stage).backgroundColor;
  context.fillRect(0, 0, copy.width, copy.height);
  context.drawImage(source, 0, 0);
  return copy.convertToBlob({ type: "image/png" });
}

function pixelsOf(self, pane, k) {
  const [x, y] = blended(self.mesh, pane.blend);
  return Array.from(x, (value, node) => self.toPane([value, y[node]], k).map((pixel) => pixel.toFixed(2)).join(" "));
}

function cellsOf(self, pane, k) {
  const pixels = pixelsOf(self, pane, k);
  const { places, uniformPlaces, isFlat } = placesOf(self.coloured, self.mesh);
  const at = (node) => (1 - pane.blend) * uniformPlaces[node] + pane.blend * places[node];
  const paths = new Map();
  eachCell(self.mesh, ([a, b, c, d]) => {
    const place = isFlat ? at(a) : (at(a) + at(b) + at(c) + at(d)) / 4;
    const colour = colourAt(self.table, self.coloured.name === "subdomain" ? place : Math.round(place * SHADES) / SHADES);
    if (!paths.has(colour)) paths.set(colour, []);
    paths.get(colour).push(`M${pixels[a]}L${pixels[b]}L${pixels[c]}L${pixels[d]}Z`);
  });
  return [...paths].map(([colour, d]) => `<path fill="${colour}" stroke="${colour}" stroke-width=".4" d="${d.join("")}"/>`);
}

function strokesOf(self, pane, k) {
  const pixels = pixelsOf(self, pane, k);
  const d = linesOf(self.mesh).map((line) => `M${line.map((node) => pixels[node]).join("L")}`);
  return `<path fill="none" stroke="#808080" stroke-opacity=".6" stroke-width=".6" d="${d.join("")}"/>`;
}
