// Pictures of what is seen: SVG with a path for each colour, and PNG of the canvas.

import { frameOf } from "./caption.js";
import { colourAt } from "../browser/colours.js";
import { blended, eachCell, linesOf } from "./nodes.js";
import { placesOf } from "./values.js";

// Colours of the cells of an SVG; cells of one colour are one path.
const SHADES = 96;
const FONT = "sans-serif";

/**
 * The stage as an SVG picture, a Blob.
 *
 * @param {object} app
 */
export async function svgOf(app) {
  const { canvas: self, store } = app;
  self.drawNow();
  const { left, width, height, shift, texts, bar } = frameOf(self, wordsOf(self));
  const { color, backgroundColor } = getComputedStyle(self.stage);
  const parts = [
    `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}">`,
    `<rect width="${width}" height="${height}" fill="${backgroundColor}"/>`,
    `<g transform="translate(${-left} ${shift})">`,
  ];
  self.panes.forEach((pane, k) => {
    const clip = `<clipPath id="pane${k}"><rect x="${pane.left}" y="${pane.top}" width="${pane.width}" height="${pane.height}"/></clipPath>`;
    parts.push(clip, `<g clip-path="url(#pane${k})">`, ...cellsOf(self, pane, k));
    if (store.get().view.lines) parts.push(strokesOf(self, pane, k));
    parts.push("</g>");
  });
  parts.push("</g>", ...texts.map((each) => textOf(each, color)), bar ? barOf(bar) : "", "</svg>");
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
  const { left, width, height, shift, texts, bar } = frameOf(self, wordsOf(self));
  const ratio = source.width / Math.max(1, self.stage.clientWidth);
  const copy = new OffscreenCanvas(Math.round(width * ratio), Math.round(height * ratio));
  const context = copy.getContext("2d");
  const { color, backgroundColor } = getComputedStyle(self.stage);
  context.scale(ratio, ratio);
  context.fillStyle = backgroundColor;
  context.fillRect(0, 0, width, height);
  context.drawImage(source, -left, shift, self.stage.clientWidth, self.stage.clientHeight);
  for (const { x, y, text, size, isBold, anchor } of texts) {
    context.font = `${isBold ? "bold " : ""}${size}px ${FONT}`;
    context.textAlign = anchor === "middle" ? "center" : anchor;
    context.fillStyle = color;
    context.fillText(text, x, y);
  }
  if (bar) {
    context.fillStyle = bar.stops.reduce((gradient, [share, colour]) => {
      gradient.addColorStop(share, colour);
      return gradient;
    }, context.createLinearGradient(bar.x, 0, bar.x + bar.width, 0));
    context.fillRect(bar.x, bar.y, bar.width, bar.height);
  }
  return copy.convertToBlob({ type: "image/png" });
}

// The headline, unless it answers another question, and the captions of the panes.
function wordsOf(self) {
  const headline = document.getElementById("headline");
  return { headline: headline.classList.contains("stale") ? "" : headline.textContent, captions: self.captions };
}

function textOf({ x, y, text, size, isBold, anchor }, colour) {
  const escaped = text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
  const weight = isBold ? ' font-weight="bold"' : "";
  return `<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" font-family="${FONT}" font-size="${size}"${weight} text-anchor="${anchor}" fill="${colour}">${escaped}</text>`;
}

function barOf({ x, y, width, height, stops }) {
  const colours = stops.map(([share, colour]) => `<stop offset="${share}" stop-color="${colour}"/>`).join("");
  return `<linearGradient id="scale">${colours}</linearGradient><rect x="${x}" y="${y}" width="${width}" height="${height}" fill="url(#scale)"/>`;
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
