// What the cells of a drawing are coloured by: values of both meshes on one scale, and their places on the colours.

import { COLOURS, placeOfClass, scaleOf } from "../browser/colours.js";
import { areasOf, cellCount, eachCell, meshOf } from "./nodes.js";

/**
 * The values of a drawing for a colour: `{name, values, uniformValues, isFlat, scale}`.
 *
 * `values` are those of the adapted mesh, at nodes for u and on cells otherwise; both meshes have the same scale.
 * Where the drawing does not have them (a weight has no u), the cell size is taken, and `name` says so.
 *
 * @param {object} drawing
 * @param {object} mesh of `meshOf`
 * @param {string} wanted a key of `COLOURS`
 */
export function valuesOf(drawing, mesh, wanted) {
  const name = isThere(drawing, wanted) ? wanted : "size";
  const [values, uniformValues] = bothOf(drawing, mesh, name);
  // An iterate has the scale of the last mesh, so that the legend stays while an iteration plays.
  const measured = drawing.like ? bothOf(drawing.like, meshOf(drawing.like), name) : [values, uniformValues];
  return { name, values, uniformValues, isFlat: name !== "u", scale: scaleOf(COLOURS[name].scale, measured) };
}

/** The interpolation errors of both meshes in L2, `{l2, l2_uniform}`, as the service measured them; null without u. */
export function errorsOf({ document: facts }) {
  return facts.quality?.interpolation_error ?? null;
}

/** Whether a drawing can be coloured by this. */
export function isThere(drawing, name) {
  if (name === "size" || name === "none") return true;
  if (name === "subdomain") return Boolean(drawing.document.subdomains?.length);
  return Boolean(drawing.arrays[name]);
}

/**
 * For each node its place from 0 to 1 on the table of colours, in both meshes; see `createRenderer`.
 *
 * @param {object} coloured of `valuesOf`
 * @param {object} mesh of `meshOf`
 */
export function placesOf({ name, values, uniformValues, isFlat, scale }, mesh) {
  const place = name === "subdomain" ? placeOfClass : name === "none" ? () => 0 : scale.place;
  const spread = (list) => (isFlat ? atFirstNodes(list, mesh, place) : Float32Array.from(list, place));
  return { places: spread(values), uniformPlaces: spread(uniformValues), isFlat };
}

// The value of a cell stands at its first node.
function atFirstNodes(list, mesh, place) {
  const places = new Float32Array(mesh.x.length);
  eachCell(mesh, ([first], cell) => {
    places[first] = place(list[cell]);
  });
  return places;
}

function bothOf(drawing, mesh, name) {
  const { arrays } = drawing;
  if (name === "size") {
    const sizes = (x, y) => areasOf([x, y], mesh).map(Math.sqrt);
    return [sizes(mesh.x, mesh.y), sizes(mesh.uniformX, mesh.uniformY)];
  }
  if (name === "none") return [[], []];
  if (name === "subdomain") {
    const numbers = subdomainsOf(drawing.document.subdomains, mesh);
    return [numbers, numbers];
  }
  return [arrays[name].data, (arrays[`uniform_${name}`] ?? arrays[name]).data];
}

// The number of the subdomain of each cell: in an overlap the one whose middle is nearer.
function subdomainsOf(subdomains, mesh) {
  const numbers = new Float32Array(cellCount(mesh));
  const away = ([first, last], cell) => Math.abs(cell + 0.5 - (first + last) / 2) / (last - first);
  eachCell(mesh, (_, cell, [, i, j]) => {
    let nearest = Infinity;
    subdomains.forEach(({ xi, eta }, number) => {
      const distance = Math.max(away(xi, i), away(eta, j));
      if (distance < nearest) {
        nearest = distance;
        numbers[cell] = number;
      }
    });
  });
  return numbers;
}
