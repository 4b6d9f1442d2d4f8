// The four sides of a domain as points, to draw them before the service has made a mesh.

import { compile } from "./formula.js";

// Points of each side in the drawing.
const POINTS = 65;

/** Whether a domain is a mesh of blocks, which has points of its own. */
export const hasBlocks = (domain) => ["blocks", "fixed_rectangle", "mesh"].includes(domain?.kind);

/** The sides in the order in which forms list them. */
export const SIDES = ["bottom", "right", "top", "left"];

/**
 * The points of the four sides of a domain; a side that cannot be read is an empty list.
 *
 * @param {object} [domain] of a spec
 * @returns {Object<string, [number, number][]>}
 */
export function sidesOf(domain = {}) {
  const curves = curvesOf(domain);
  return Object.fromEntries(SIDES.map((name) => [name, pointsOf(curves[name])]));
}

/**
 * The domain as four curves of a quadrilateral.
 *
 * @param {object} domain
 * @returns {Object<string, object>}
 */
export function curvesOf(domain = {}) {
  if (hasBlocks(domain)) return {};
  if (domain.kind === "quadrilateral") return domain;
  if (domain.kind === "annulus_sector") return arcs(domain);
  const { x: [x0, x1] = [0, 1], y: [y0, y1] = [0, 1] } = domain;
  const line = (...points) => ({ points });
  return {
    bottom: line([x0, y0], [x1, y0]),
    right: line([x1, y0], [x1, y1]),
    top: line([x0, y1], [x1, y1]),
    left: line([x0, y0], [x0, y1]),
  };
}

/**
 * The edges of the blocks of a description as lists of points: straight lines, and arcs of circles; other curves are
 * drawn by the service alone. Of a rectangle with fixed nodes its sides and its curves by formulas or through points.
 *
 * @param {object} domain
 * @returns {[number, number][][]}
 */
export function edgesOf({ kind, vertices = {}, curves = {}, edges = [], blocks = [], x = [0, 1], y = [0, 1] }) {
  if (kind === "fixed_rectangle") {
    const [[left, right], [bottom, top]] = [listOf(x), listOf(y)];
    const corners = [[left, bottom], [right, bottom], [right, top], [left, top]];
    if (!corners.flat().every(Number.isFinite)) return [];
    const inside = Object.values(curves ?? {}).filter(Boolean).map(pointsOf);
    return [...corners.map((corner, k) => [corner, corners[(k + 1) % 4]]), ...inside].filter((points) => points.length);
  }
  if (kind !== "blocks") return [];
  const ends = new Map();
  for (const { corners = [] } of listOf(blocks)) {
    listOf(corners).forEach((name, k) => {
      const other = corners[(k + 1) % corners.length];
      ends.set([name, other].sort().join("\n"), [name, other]);
    });
  }
  const on = new Map(listOf(edges).map((edge) => [[edge?.from, edge?.to].sort().join("\n"), edge]));
  return [...ends].map(([key, names]) => {
    const points = names.map((name) => vertices[name]);
    if (!points.every((point) => Array.isArray(point) && point.length === 2 && point.every(Number.isFinite))) return [];
    const circle = curves[on.get(key)?.on]?.circle;
    return circle ? arcBetween(points, circle) : points;
  }).filter((points) => points.length);
}

const listOf = (value) => (Array.isArray(value) ? value : []);

// The shorter arc between two points on a circle.
function arcBetween([first, last], { center: [cx, cy] = [0, 0], radius = 1 }) {
  const angle = ([x, y]) => Math.atan2(y - cy, x - cx);
  const start = angle(first);
  const turn = ((angle(last) - start + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
  return Array.from({ length: 17 }, (_, k) => {
    const at = start + (turn * k) / 16;
    return [cx + radius * Math.cos(at), cy + radius * Math.sin(at)];
  });
}

/** The points of one curve of a spec: two formulas in t, or a cubic spline through points. */
export function pointsOf(curve = {}) {
  if (curve.points) return curve.points.length < 3 ? curve.points : spline(curve.points);
  const [x, y] = [compile(String(curve.x ?? "")), compile(String(curve.y ?? ""))];
  if (!x || !y) return [];
  const points = Array.from({ length: POINTS }, (_, k) => {
    const names = { ...curve.parameters, t: k / (POINTS - 1) };
    return [x(names), y(names)];
  });
  return points.every((point) => point.every(Number.isFinite)) ? points : [];
}

function arcs({ center: [cx, cy] = [0, 0], radii: [inner, outer] = [1, 2], closed = false, angles: [first, last] = closed ? [0, 360] : [0, 90] }) {
  const plus = (value) => (value === 0 ? "" : `${value} + `);
  const turned = `(${first} + ${last - first}*t)*pi/180`;
  const arc = (radius) => ({ x: `${plus(cx)}${radius}*cos(${turned})`, y: `${plus(cy)}${radius}*sin(${turned})` });
  const ray = (angle) => {
    const [along, across] = [Math.cos((angle * Math.PI) / 180), Math.sin((angle * Math.PI) / 180)].map(exact);
    return { points: [inner, outer].map((radius) => [cx + radius * along, cy + radius * across]) };
  };
  return { bottom: ray(first), right: arc(outer), top: ray(last), left: arc(inner) };
}

// The cosine of a right angle is not exactly 0 in the arithmetic of the machine.
const exact = (value) => (Math.abs(value) < 1e-15 ? 0 : value);

// The cubic spline through points by the length of chords; its third derivative is continuous at the second point and
// at the last but one, as in SciPy's CubicSpline, which the service uses.
function spline(points) {
  const knots = [0];
  for (let k = 1; k < points.length; k += 1) {
    const [dx, dy] = [points[k][0] - points[k - 1][0], points[k][1] - points[k - 1][1]];
    knots.push(knots[k - 1] + Math.hypot(dx, dy));
  }
  if (knots.some((knot, k) => k > 0 && !(knot > knots[k - 1]))) return points;
  const [x, y] = [0, 1].map((axis) => interpolant(knots, points.map((point) => point[axis])));
  const end = knots[knots.length - 1];
  const count = Math.min(POINTS * 4, POINTS + 8 * points.length);
  return Array.from({ length: count }, (_, k) => [x((k / (count - 1)) * end), y((k / (count - 1)) * end)]);
}

function interpolant(knots, values) {
  const last = knots.length - 1;
  const h = knots.slice(1).map((knot, k) => knot - knots[k]);
  if (last === 2) return parabola(knots, values);
  const slopes = h.map((step, k) => (values[k + 1] - values[k]) / step);
  // Second derivatives at the inner knots; those of the ends follow from the condition on the third derivative.
  const [lower, middle, upper, right] = [[], [], [], []];
  for (let k = 1; k < last; k += 1) {
    lower.push(h[k - 1]);
    middle.push(2 * (h[k - 1] + h[k]));
    upper.push(h[k]);
    right.push(6 * (slopes[k] - slopes[k - 1]));
  }
  const [a, b] = [h[0] / h[1], h[last - 1] / h[last - 2]];
  middle[0] += h[0] * (1 + a);
  upper[0] -= h[0] * a;
  middle[last - 2] += h[last - 1] * (1 + b);
  lower[last - 2] -= h[last - 1] * b;
  const inner = tridiagonal(lower, middle, upper, right);
  const bends = [(1 + a) * inner[0] - a * inner[1], ...inner, (1 + b) * inner[last - 2] - b * inner[last - 3]];
  return (t) => {
    let k = 0;
    while (k < last - 1 && t > knots[k + 1]) k += 1;
    const [before, after] = [(knots[k + 1] - t) / h[k], (t - knots[k]) / h[k]];
    const bend = ((before ** 3 - before) * bends[k] + (after ** 3 - after) * bends[k + 1]) * (h[k] ** 2 / 6);
    return before * values[k] + after * values[k + 1] + bend;
  };
}

// Three points have no more than a parabola.
function parabola([t0, t1, t2], [v0, v1, v2]) {
  return (t) =>
    (v0 * (t - t1) * (t - t2)) / ((t0 - t1) * (t0 - t2)) +
    (v1 * (t - t0) * (t - t2)) / ((t1 - t0) * (t1 - t2)) +
    (v2 * (t - t0) * (t - t1)) / ((t2 - t0) * (t2 - t1));
}

function tridiagonal(lower, middle, upper, right) {
  const [pivots, values] = [[...middle], [...right]];
  for (let k = 1; k < pivots.length; k += 1) {
    const factor = lower[k] / pivots[k - 1];
    pivots[k] -= factor * upper[k - 1];
    values[k] -= factor * values[k - 1];
  }
  for (let k = pivots.length - 1; k >= 0; k -= 1) {
    values[k] = (values[k] - (k + 1 < pivots.length ? upper[k] * values[k + 1] : 0)) / pivots[k];
  }
  return values;
}
