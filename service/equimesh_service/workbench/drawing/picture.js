// Pictures of what is seen: SVG with a path for each colour, and PNG of the canvas.

import { colourAt } from "./colours.js";
import { blended } from "./nodes.js";
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
    if (store.get().view.lines) parts.push(linesOf(self, pane, k));
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
  const [n, m] = self.mesh.shape;
  const pixels = pixelsOf(self, pane, k);
  const { places, uniformPlaces, isFlat } = placesOf(self.coloured, self.mesh.shape);
  const at = (node) => (1 - pane.blend) * uniformPlaces[node] + pane.blend * places[node];
  const paths = new Map();
  for (let i = 0; i < n - 1; i += 1) {
    for (let j = 0; j < m - 1; j += 1) {
      const node = i * m + j;
      const place = isFlat ? at(node) : (at(node) + at(node + 1) + at(node + m) + at(node + m + 1)) / 4;
      const colour = colourAt(self.table, self.coloured.name === "subdomain" ? place : Math.round(place * SHADES) / SHADES);
      const path = `M${pixels[node]}L${pixels[node + m]}L${pixels[node + m + 1]}L${pixels[node + 1]}Z`;
      if (!paths.has(colour)) paths.set(colour, []);
      paths.get(colour).push(path);
    }
  }
  return [...paths].map(([colour, d]) => `<path fill="${colour}" stroke="${colour}" stroke-width=".4" d="${d.join("")}"/>`);
}

function linesOf(self, pane, k) {
  const [n, m] = self.mesh.shape;
  const pixels = pixelsOf(self, pane, k);
  const d = [];
  for (let i = 0; i < n; i += 1) d.push(`M${pixels.slice(i * m, (i + 1) * m).join("L")}`);
  for (let j = 0; j < m; j += 1) d.push(`M${Array.from({ length: n }, (_, i) => pixels[i * m + j]).join("L")}`);
  return `<path fill="none" stroke="#808080" stroke-opacity=".6" stroke-width=".6" d="${d.join("")}"/>`;
}
