// Meshes in a browser: previews by arc length and by least error, with the equations of the solver, on four sides.
//
// Nodes (i, j) of a grid of n x m points have the number i m + j.  A mesh is `{s, t}`, its coordinates on the reference
// square; a domain maps these to x and y.  Every mesh that is given is valid: all corners of its cells are positive.

import { FormulaError, compile, keeping } from "./formula.js";

export { FormulaError, compile };

// Domains: the images of the unit square.

/**
 * A domain from its description in a request: the unit square, a rectangle, a sector of a ring, or four curves.
 *
 * `map(s, t)` gives arrays `[x, y, x_s, x_t, y_s, y_t]`, `isIdentity` tells that x is s and y is t.  Throws a
 * `FormulaError` for a domain that is not known here.
 *
 * @param {object} [description]
 */
export function domainOf(description) {
  const { kind = "rectangle", periodic, closed } = description ?? {};
  if (periodic || closed) throw new FormulaError("the kernel of the page has no closed lines: the service makes this mesh");
  const known = { rectangle, annulus_sector: sector, quadrilateral };
  if (!Object.hasOwn(known, kind)) throw new FormulaError(`the kernel of the page has no domain of the kind ${kind}: the service makes this mesh`);
  return known[kind](description ?? {});
}

const arraysFor = (count) => Array.from({ length: 6 }, () => new Float64Array(count));

function rectangle({ x: [x0, x1] = [0, 1], y: [y0, y1] = [0, 1] }) {
  const isIdentity = x0 === 0 && x1 === 1 && y0 === 0 && y1 === 1;
  const map = (s, t) => {
    const [x, y, x_s, x_t, y_s, y_t] = arraysFor(s.length);
    for (let k = 0; k < s.length; k += 1) {
      x[k] = x0 * (1 - s[k]) + x1 * s[k];
      y[k] = y0 * (1 - t[k]) + y1 * t[k];
    }
    return [x, y, x_s.fill(x1 - x0), x_t, y_s, y_t.fill(y1 - y0)];
  };
  return { map, isIdentity, isStraight: true, area: (x1 - x0) * (y1 - y0) };
}

function sector({ center: [a, b] = [0, 0], radii: [inner, outer] = [1, 2], angles: [first, last] = [0, 90] }) {
  const turn = ((last - first) * Math.PI) / 180;
  const map = (s, t) => {
    const [x, y, x_s, x_t, y_s, y_t] = arraysFor(s.length);
    for (let k = 0; k < s.length; k += 1) {
      const radius = inner + (outer - inner) * s[k], angle = (first * Math.PI) / 180 + turn * t[k];
      const cosine = Math.cos(angle), sine = Math.sin(angle);
      x[k] = a + radius * cosine;
      y[k] = b + radius * sine;
      x_s[k] = (outer - inner) * cosine;
      y_s[k] = (outer - inner) * sine;
      x_t[k] = -radius * turn * sine;
      y_t[k] = radius * turn * cosine;
    }
    return [x, y, x_s, x_t, y_s, y_t];
  };
  return { map, isIdentity: false, isStraight: false, area: 0.5 * (outer - inner) * (outer + inner) * turn };
}

// The Coons patch between four curves.
function quadrilateral(description) {
  const [bottom, right, top, left] = ["bottom", "right", "top", "left"].map((side) => curveOf(description[side], side));
  const ends = (curve) => curve(Float64Array.of(0, 1)).map((part) => [...part]);
  const low = ends(bottom), high = ends(top);
  const map = (s, t) => {
    const b = bottom(s), u = top(s), l = left(t), r = right(t), out = arraysFor(s.length);
    for (let c = 0; c < 2; c += 1) {
      const [c00, c10] = low[c], [c01, c11] = high[c];
      const value = out[c], along = out[2 + 2 * c], across = out[3 + 2 * c];
      const bq = b[c], uq = u[c], lq = l[c], rq = r[c], bs = b[c + 2], us = u[c + 2], lt = l[c + 2], rt = r[c + 2];
      for (let k = 0; k < s.length; k += 1) {
        const p = s[k], q = t[k];
        const fromLeft = lq[k] - (1 - q) * c00 - q * c01, fromRight = rq[k] - (1 - q) * c10 - q * c11;
        value[k] = (1 - q) * bq[k] + q * uq[k] + (1 - p) * fromLeft + p * fromRight;
        along[k] = (1 - q) * bs[k] + q * us[k] + fromRight - fromLeft;
        across[k] = uq[k] - bq[k] + (1 - p) * (lt[k] - (c01 - c00)) + p * (rt[k] - (c11 - c10));
      }
    }
    return out;
  };
  return { map, isIdentity: false, isStraight: false, area: areaOf(map) };
}

// [x, y, x_t, y_t] of a side at values of t.
function curveOf({ x, y, parameters = {}, points } = {}, side) {
  if (points?.length === 2) {
    const [[x0, y0], [x1, y1]] = points;
    return (t) => [t.map((at) => x0 + at * (x1 - x0)), t.map((at) => y0 + at * (y1 - y0)), t.map(() => x1 - x0), t.map(() => y1 - y0)];
  }
  if (typeof x !== "string" || typeof y !== "string") throw new FormulaError(`the kernel of the page has no spline for the side ${side}: the service makes this mesh`);
  const formulas = [x, y].map((text) => compile(text, parameters, ["t"]));
  return (t) => {
    const [[px, dx], [py, dy]] = formulas.map((formula) => formula.evaluate(t, t).map((part) => part.slice()));
    return [px, py, dx, dy];
  };
}

function areaOf(map, count = 129) {
  const { s, t } = uniform(count, count);
  const [, , x_s, x_t, y_s, y_t] = map(s.map((at) => (at * (count - 1) + 0.5) / count), t.map((at) => (at * (count - 1) + 0.5) / count));
  return x_s.reduce((sum, one, k) => sum + one * y_t[k] - x_t[k] * y_s[k], 0) / count ** 2;
}

/** The uniform mesh of n x m points. */
export function uniform(n, m) {
  return product(linspace(n), linspace(m));
}

const linspace = (count) => Float64Array.from({ length: count }, (_, k) => k / (count - 1));

function product(lines, others) {
  const m = others.length;
  const s = Float64Array.from({ length: lines.length * m }, (_, k) => lines[Math.floor(k / m)]);
  return { s, t: Float64Array.from({ length: lines.length * m }, (_, k) => others[k % m]) };
}

const placesOf = (domain, { s, t }) => (domain.isIdentity ? [s, t] : domain.map(s, t));

// Nodal values on another grid, by cubic or linear interpolation.
function interpolated(values, [n, m], [fineN, fineM], isCubic) {
  const along = ruleOf(n, fineN, isCubic), across = ruleOf(m, fineM, isCubic);
  const half = new Float64Array(n * fineM);
  for (let i = 0; i < n; i += 1) {
    for (let j = 0; j < fineM; j += 1) {
      for (let w = 0; w < 4; w += 1) half[i * fineM + j] += across.weights[4 * j + w] * values[i * m + across.first[j] + w];
    }
  }
  const out = new Float64Array(fineN * fineM);
  for (let i = 0; i < fineN; i += 1) {
    for (let w = 0; w < 4; w += 1) {
      const weight = along.weights[4 * i + w], row = (along.first[i] + w) * fineM;
      for (let j = 0; j < fineM; j += 1) out[i * fineM + j] += weight * half[row + j];
    }
  }
  return out;
}

function ruleOf(coarse, fine, isCubic) {
  const first = new Int32Array(fine), weights = new Float64Array(4 * fine);
  for (let k = 0; k < fine; k += 1) {
    const place = (k * (coarse - 1)) / (fine - 1);
    const cell = Math.min(Math.floor(place), coarse - 2);
    first[k] = Math.min(Math.max(cell - 1, 0), coarse - 4);
    const at = place - first[k];
    for (let w = 0; w < 4; w += 1) {
      let weight = 1;
      for (let other = 0; other < 4; other += 1) if (other !== w) weight *= (at - other) / (w - other);
      weights[4 * k + w] = isCubic ? weight : Math.max(0, 1 - Math.abs(at - w));
    }
  }
  return { first, weights };
}

// Jacobians of the corners of cells; corner c of a cell is followed by c + 1, counter-clockwise.

const cornersOf = (i, j, m) => [i * m + j, (i + 1) * m + j, (i + 1) * m + j + 1, i * m + j + 1];

// The corners of all cells, four after four.
const cellsOf = keeping((n, m) => {
  const cells = new Int32Array(4 * (n - 1) * (m - 1));
  for (let i = 0, at = 0; i < n - 1; i += 1) for (let j = 0; j < m - 1; j += 1, at += 4) cells.set(cornersOf(i, j, m), at);
  return cells;
});

function cornerAt(x, y, cells, c, k) {
  const p = cells[c + k], a = cells[c + ((k + 1) & 3)], b = cells[c + ((k + 3) & 3)];
  return (x[a] - x[p]) * (y[b] - y[p]) - (y[a] - y[p]) * (x[b] - x[p]);
}

/** The smallest Jacobian of a corner over that of another mesh; not positive for a folded mesh. */
function smallestShare([x, y], [x0, y0], cells) {
  let smallest = Infinity;
  for (let c = 0; c < cells.length; c += 4) {
    for (let k = 0; k < 4; k += 1) {
      const share = cornerAt(x, y, cells, c, k) / cornerAt(x0, y0, cells, c, k);
      if (!(share >= smallest)) smallest = share;
    }
  }
  return Number.isFinite(smallest) ? smallest : -Infinity;
}

// Quadrature on a cell: shape functions and their derivatives at Gauss points of the unit square.

const GAUSS = {
  2: [[-0.5773502691896257, 1], [0.5773502691896257, 1]],
  3: [[-0.7745966692414834, 5 / 9], [0, 8 / 9], [0.7745966692414834, 5 / 9]],
  4: [[-0.8611363115940526, 0.34785484513745385], [-0.33998104358485626, 0.6521451548625462], [0.33998104358485626, 0.6521451548625462], [0.8611363115940526, 0.34785484513745385]],
};

function elementOf(points) {
  const line = GAUSS[points].map(([at, weight]) => [(at + 1) / 2, weight / 2]);
  return line.flatMap(([p, one]) => line.map(([q, other]) => ({
    weight: one * other,
    shape: [(1 - p) * (1 - q), p * (1 - q), p * q, (1 - p) * q],
    alongS: [q - 1, 1 - q, q, -q],
    alongT: [p - 1, -p, p, 1 - p],
  })));
}
const ELEMENTS = { 2: elementOf(2), 3: elementOf(3), 4: elementOf(4) };

// The points of quadrature of all cells: point q of cell c is q count + c.
function quadrature(x, y, cells, element, at) {
  const count = cells.length / 4;
  element.forEach(({ shape: [n0, n1, n2, n3] }, q) => {
    for (let c = 0; c < count; c += 1) {
      const a = cells[4 * c], b = cells[4 * c + 1], d = cells[4 * c + 2], e = cells[4 * c + 3];
      at.x[q * count + c] = n0 * x[a] + n1 * x[b] + n2 * x[d] + n3 * x[e];
      at.y[q * count + c] = n0 * y[a] + n1 * y[b] + n2 * y[d] + n3 * y[e];
    }
  });
  return at;
}

const pointsOf = keeping((count) => pointsFor(count, ELEMENTS[4]));
const pointsFor = (count, element) => ({ x: new Float64Array(count * element.length), y: new Float64Array(count * element.length) });

/**
 * The error of interpolating u bilinearly on a mesh: `{l2, cells}`, the norm on the whole mesh, and its shares of the
 * cells, the norms on these.
 *
 * @param {object} u of `compile`
 * @param {object} domain of `domainOf`
 * @param {{s: Float64Array, t: Float64Array}} mesh
 * @param {number[]} shape
 */
export function errorOf(u, domain, mesh, [n, m]) {
  const [x, y] = placesOf(domain, mesh);
  const cells = cellsOf(n, m);
  const element = ELEMENTS[4];
  const count = cells.length / 4;
  const nodal = u.values(x, y).slice();
  const at = quadrature(x, y, cells, element, pointsOf(count));
  const exact = u.values(at.x, at.y);
  const squares = new Float64Array(count);
  element.forEach(({ weight, shape: [n0, n1, n2, n3], alongS, alongT }, q) => {
    const s0 = alongS[0], s2 = alongS[2], t0 = alongT[0], t2 = alongT[2];
    for (let c = 0; c < count; c += 1) {
      const a = cells[4 * c], b = cells[4 * c + 1], d = cells[4 * c + 2], o = cells[4 * c + 3];
      const x_s = s2 * (x[d] - x[o]) - s0 * (x[b] - x[a]);
      const y_s = s2 * (y[d] - y[o]) - s0 * (y[b] - y[a]);
      const x_t = t2 * (x[d] - x[b]) - t0 * (x[o] - x[a]);
      const y_t = t2 * (y[d] - y[b]) - t0 * (y[o] - y[a]);
      const e = n0 * nodal[a] + n1 * nodal[b] + n2 * nodal[d] + n3 * nodal[o] - exact[q * count + c];
      squares[c] += weight * (x_s * y_t - x_t * y_s) * e * e;
    }
  });
  return { l2: Math.sqrt(squares.reduce((sum, one) => sum + one, 0)), cells: squares.map(Math.sqrt) };
}

// The arc length: nodes at equal metric lengths along both families of lines, and along the sides.

const STRENGTH = { a: 0.7, b: 0.05 };
const RANGE_POINTS = 65;
// Sweeps at most, and the largest move of a node, in spacings, at which they end: on the finest grid, and on coarser ones.
const MOST_SWEEPS = [200, 30];
const SETTLED = [5e-5, 1e-3];

/** Grids from coarse to fine, each with about half the cells of the next, of which the first has about eight a side. */
export function levelsOf([n, m]) {
  const halvings = [n, m].map((points) => Math.max(0, Math.round(Math.log2((points - 1) / 8))));
  const count = Math.max(...halvings) + 1;
  return Array.from({ length: count }, (_, number) => [n, m].map((points, k) => Math.max(3, Math.round((points - 1) / 2 ** Math.max(halvings[k] - number, 0))) + 1));
}

/**
 * The steps of the arc-length mesh with these points: each yields `{mesh, shape, isLast, isConverged}`.
 *
 * The equations are the solver's: Haynes and Howse (5), with the trace condition on the sides.  Points are moved along
 * the lines, family after family, to equal metric lengths; a move that would fold a cell is shortened.  `start` and
 * `steps` are those of `leastError`.
 *
 * @param {object} u of `compile`
 * @param {number[]} shape
 * @param {object} domain of `domainOf`
 * @param {{a?: number, b?: number, scaled?: boolean, start?: object, steps?: number}} [settings]
 */
export function* arcLength(u, shape, domain, { a = STRENGTH.a, b = STRENGTH.b, scaled = true, start = null, steps = Infinity } = {}) {
  const factor = scaled ? rangeFactor(u, domain) : 1;
  const levels = start ? [shape] : levelsOf(shape);
  let mesh = start ?? uniform(...levels[0]);
  for (const [number, [n, m]] of levels.entries()) {
    if (number > 0) mesh = liftedMesh(mesh, levels[number - 1], [n, m], uniform);
    const isFinest = number === levels.length - 1;
    const sweep = sweeper(u, domain, [n, m], { a, b, factor });
    let isConverged = false;
    for (let k = 0; k < Math.min(steps, MOST_SWEEPS[+!isFinest]) && !isConverged; k += 1) {
      const moved = sweep(mesh);
      if (!moved) break;
      mesh = moved.mesh;
      isConverged = moved.largest <= SETTLED[+!isFinest];
      yield { mesh, shape: [n, m], isLast: false, isConverged };
    }
    if (isFinest) yield { mesh, shape: [n, m], isLast: true, isConverged };
  }
}

// The size of the domain over the range of u.
function rangeFactor(u, domain) {
  const [x, y] = placesOf(domain, uniform(RANGE_POINTS, RANGE_POINTS));
  const known = u.values(x, y).filter(Number.isFinite);
  const low = known.reduce((p, q) => Math.min(p, q), Infinity), high = known.reduce((p, q) => Math.max(p, q), -Infinity);
  if (!(high - low > 1e-12 * Math.max(Math.abs(low), Math.abs(high)))) return 0;
  return Math.sqrt(domain.area) / (high - low);
}

// One pass over all lines: a function of a mesh that gives `{mesh, largest}`, or null where no move keeps it valid.
function sweeper(u, domain, [n, m], { a, b, factor }) {
  const cells = cellsOf(n, m);
  const flat = uniform(n, m);
  const first = placesOf(domain, flat);
  const metric = metricOn(u, domain, [n, m], { a2: a * a, b, factor });
  const families = [
    { lines: m, points: n, step: m, next: 1, own: "s", other: "t" },
    { lines: n, points: m, step: 1, next: m, own: "t", other: "s" },
  ];
  return (mesh) => {
    let now = mesh, largest = 0;
    for (const family of families) {
      const wanted = placed(now, metric, family, u, domain, { a2: a * a, b, factor });
      let share = 1;
      let moved = wanted;
      while (!(smallestShare(placesOf(domain, moved), first, cells) > 0)) {
        share /= 2;
        if (share < 1e-3) return null;
        moved = { s: between(now.s, wanted.s, share), t: between(now.t, wanted.t, share) };
      }
      for (const name of ["s", "t"]) for (let k = 0; k < now[name].length; k += 1) largest = Math.max(largest, Math.abs(moved[name][k] - now[name][k]) * (n - 1));
      now = moved;
    }
    return { mesh: now, largest };
  };
}

const between = (from, to, share) => from.map((one, k) => one + share * (to[k] - one));

// The metric of every cell, [m11, m12, m22], with the gradient of u by differences on the mesh.
function metricOn(u, domain, [n, m], { a2, b, factor }) {
  const count = (n - 1) * (m - 1);
  const s = new Float64Array(count), t = new Float64Array(count);
  const out = [new Float64Array(count), new Float64Array(count), new Float64Array(count)];
  return (mesh) => {
    const [x, y] = placesOf(domain, mesh);
    const nodal = u.values(x, y);
    for (let i = 0, c = 0; i < n - 1; i += 1) for (let j = 0; j < m - 1; j += 1, c += 1) {
      const k = i * m + j;
      s[c] = (mesh.s[k] + mesh.s[k + 1] + mesh.s[k + m] + mesh.s[k + m + 1]) / 4;
      t[c] = (mesh.t[k] + mesh.t[k + 1] + mesh.t[k + m] + mesh.t[k + m + 1]) / 4;
    }
    const map = domain.isIdentity ? null : domain.map(s, t);
    for (let i = 0, c = 0; i < n - 1; i += 1) for (let j = 0; j < m - 1; j += 1, c += 1) {
      const p = i * m + j, q = (i + 1) * m + j, r = (i + 1) * m + j + 1, o = i * m + j + 1;
      const dx = mesh.s[r] - mesh.s[p], dy = mesh.t[r] - mesh.t[p], du = factor * (nodal[r] - nodal[p]);
      const ox = mesh.s[q] - mesh.s[o], oy = mesh.t[q] - mesh.t[o], ou = factor * (nodal[q] - nodal[o]);
      const inverse = 1 / (ox * dy - dx * oy);
      const gx = (ou * dy - du * oy) * inverse, gy = (ox * du - dx * ou) * inverse;
      const [b11, b12, b22] = map ? pulledBack(map, c) : FLAT;
      const k = a2 / (1 + (b * (b22 * gx * gx - 2 * b12 * gx * gy + b11 * gy * gy)) / (b11 * b22 - b12 * b12));
      out[0][c] = b11 + k * gx * gx;
      out[1][c] = b12 + k * gx * gy;
      out[2][c] = b22 + k * gy * gy;
    }
    return out;
  };
}

const FLAT = [1, 0, 1];
const pulledBack = ([, , x_s, x_t, y_s, y_t], k) => [x_s[k] ** 2 + y_s[k] ** 2, x_s[k] * x_t[k] + y_s[k] * y_t[k], x_t[k] ** 2 + y_t[k] ** 2];

// The mesh with the points of one family of lines at equal metric lengths along these.
function placed(mesh, metric, { lines, points, step, next, own, other }, u, domain, strength) {
  const wanted = { s: mesh.s.slice(), t: mesh.t.slice() };
  const [m11, m12, m22] = metric(mesh);
  const perRow = own === "s" ? lines - 1 : points - 1; // cells of a row of the arrays
  const cellAt = (along, across) => (own === "s" ? along * perRow + across : across * perRow + along);
  const lengths = new Float64Array(points);
  for (let line = 0; line < lines; line += 1) {
    const first = line * next;
    const isSide = line === 0 || line === lines - 1;
    const side = isSide ? sideFluxes(mesh, { first, points, step, own, end: line === 0 ? 0 : 1 }, u, domain, strength) : null;
    for (let e = 0; e < points - 1; e += 1) {
      let flux = side?.[e];
      if (!isSide) {
        const k = first + e * step;
        const d = mesh.s[k + step] - mesh.s[k], h = mesh.t[k + step] - mesh.t[k];
        const below = cellAt(e, line - 1), above = cellAt(e, line);
        flux = 0.5 * ((m11[below] + m11[above]) * d * d + 2 * (m12[below] + m12[above]) * d * h + (m22[below] + m22[above]) * h * h);
      }
      lengths[e + 1] = lengths[e] + Math.sqrt(flux);
    }
    let edge = 0;
    for (let e = 1; e < points - 1; e += 1) {
      const at = (lengths[points - 1] * e) / (points - 1);
      while (lengths[edge + 1] < at) edge += 1;
      const share = (at - lengths[edge]) / (lengths[edge + 1] - lengths[edge]);
      const from = first + edge * step, to = first + (edge + 1) * step;
      wanted[own][first + e * step] = mesh[own][from] + share * (mesh[own][to] - mesh[own][from]);
      if (!isSide) wanted[other][first + e * step] = mesh[other][from] + share * (mesh[other][to] - mesh[other][from]);
    }
  }
  return wanted;
}

// The squared metric lengths of the edges of a side: the trace condition, with the full gradient of u.
function sideFluxes(mesh, { first, points, step, own, end }, u, domain, { a2, b, factor }) {
  const along = Float64Array.from({ length: points }, (_, k) => mesh[own][first + k * step]);
  const place = (at) => {
    const fixed = at.map(() => end);
    return own === "s" ? { s: at, t: fixed } : { s: fixed, t: at };
  };
  const [x, y, x_s, x_t, y_s, y_t] = placesOf(domain, place(along));
  const [value, u_x, u_y] = u.evaluate(x, y);
  const normal = value.map((_, k) => {
    const [by_x, by_y] = own === "s" ? [x_t?.[k] ?? 0, y_t?.[k] ?? 1] : [x_s?.[k] ?? 1, y_s?.[k] ?? 0];
    return factor * (u_x[k] * by_x + u_y[k] * by_y);
  });
  const nodal = value.slice();
  const map = domain.isIdentity ? null : domain.map(...Object.values(place(along.slice(1).map((one, k) => (one + along[k]) / 2))));
  return Array.from({ length: points - 1 }, (_, e) => {
    const d = along[e + 1] - along[e], du = factor * (nodal[e + 1] - nodal[e]);
    const base = map ? pulledBack(map, e) : FLAT;
    const [b11, b12, b22] = own === "s" ? base : [base[2], base[1], base[0]];
    const g = du / d, h = 0.5 * (normal[e] + normal[e + 1]);
    const square = (b22 * g * g - 2 * b12 * g * h + b11 * h * h) / (b11 * b22 - b12 * b12);
    return b11 * d * d + (a2 / (1 + b * square)) * du * du;
  });
}

// Least error: descent on the measured error of interpolation, on nested meshes.

const STEPS = [[17 * 17, 45], [33 * 33, 40], [65 * 65, 18], [129 * 129, 5]];
const POINTS = [[9 * 9, 4], [17 * 17, 3]];
const MOST_COMPARED = 17 * 17;
const DISTORTION = 0.06;
const SMOOTHNESS = 2.4e-4;
const LEAST_DECREASE = 2.5e-3;
const PATIENCE = 3;
const PAIRS = 8;
const STEPS_A_PRECONDITIONER = 5;
const MOST_MOVE = 2;
const SHORTENING = 0.4;
const MOST_TRIALS = 9;
const LEAST_SHARE = 1e-4;
const MOST_LIFTED = 1.5;
const MORE_CUT_OFF = 0.25;

const upTo = (table, points, beyond) => (table.find(([most]) => points <= most) ?? [0, beyond])[1];

// A mesh on another grid: displacements from the first mesh there by cubic, else linear interpolation, else positions.
function liftedMesh(mesh, coarse, fine, firstMesh) {
  const start = firstMesh(...fine), first = firstMesh(...coarse);
  const cells = cellsOf(...fine);
  for (const [origin, isCubic] of [[first, true], [first, false], [null, false]]) {
    const lifted = {};
    for (const name of ["s", "t"]) {
      const part = origin ? mesh[name].map((one, k) => one - origin[name][k]) : mesh[name];
      lifted[name] = interpolated(part, coarse, fine, isCubic);
      if (origin) lifted[name] = lifted[name].map((one, k) => one + start[name][k]);
    }
    heldToSides(lifted, fine);
    if (smallestShare([lifted.s, lifted.t], [start.s, start.t], cells) > 0) return lifted;
  }
  return start;
}

function heldToSides({ s, t }, [n, m]) {
  for (let j = 0; j < m; j += 1) [s[j], s[(n - 1) * m + j]] = [0, 1];
  for (let i = 0; i < n; i += 1) [t[i * m], t[i * m + m - 1]] = [0, 1];
}

// The function that a descent makes small: log of the error, distortion relative to the start, and second differences
// of the displacement from it.
function createObjective(u, domain, [n, m], start, initial, points, finestCells) {
  const cells = cellsOf(n, m);
  const count = cells.length / 4, size = n * m;
  const element = ELEMENTS[points], weight = { distortion: 0.5 * DISTORTION, smoothness: SMOOTHNESS * count };
  const at = pointsFor(count, element);
  const first = placesOf(domain, start).slice(0, 2).map((one) => one.slice());
  const sums = new Float64Array(5 * size);
  const stiffness = stiffnessOf(n, m);
  const mostCutOff = domain.isStraight ? Infinity : boundOfCutOff(cutOff(domain, initial, [n, m]), finestCells / count, domain.area);
  const cutsOff = (mesh) => mostCutOff < Infinity && cutOff(domain, mesh, [n, m]) > mostCutOff;

  // The squared error; adds its derivatives to the sums.  NaN where u is not finite.
  function squaredError(x, y) {
    sums.fill(0);
    const [nodal, nodal_x, nodal_y] = u.evaluate(x, y).map((part) => part.slice());
    quadrature(x, y, cells, element, at);
    const [value, value_x, value_y] = u.evaluate(at.x, at.y);
    let total = 0;
    element.forEach(({ weight: share, shape, alongS, alongT }, q) => {
      const [n0, n1, n2, n3] = shape;
      const s0 = alongS[0], s2 = alongS[2], t0 = alongT[0], t2 = alongT[2];
      for (let c = 0; c < count; c += 1) {
        const a = cells[4 * c], b = cells[4 * c + 1], d = cells[4 * c + 2], o = cells[4 * c + 3], p = q * count + c;
        const x_s = s2 * (x[d] - x[o]) - s0 * (x[b] - x[a]);
        const y_s = s2 * (y[d] - y[o]) - s0 * (y[b] - y[a]);
        const x_t = t2 * (x[d] - x[b]) - t0 * (x[o] - x[a]);
        const y_t = t2 * (y[d] - y[b]) - t0 * (y[o] - y[a]);
        const e = n0 * nodal[a] + n1 * nodal[b] + n2 * nodal[d] + n3 * nodal[o] - value[p];
        const area = share * (x_s * y_t - x_t * y_s);
        const square = share * e * e;
        total += area * e * e;
        for (let k = 0; k < 4; k += 1) {
          const node = cells[4 * c + k], part = shape[k];
          const d_x = nodal_x[node] - value_x[p], d_y = nodal_y[node] - value_y[p], factor = 2 * area * part;
          sums[5 * node] += factor * e * d_x + square * (alongS[k] * y_t - alongT[k] * y_s);
          sums[5 * node + 1] += factor * e * d_y + square * (alongT[k] * x_s - alongS[k] * x_t);
          sums[5 * node + 2] += factor * part * d_x * d_x;
          sums[5 * node + 3] += factor * part * d_x * d_y;
          sums[5 * node + 4] += factor * part * d_y * d_y;
        }
      }
    });
    return total;
  }

  // The sum of (r^2 - 1) / 2 over all corners; adds `scale` times its derivatives to the sums.
  function distortion(x, y, scale) {
    const [x0, y0] = first;
    let total = 0;
    for (let c = 0; c < cells.length; c += 4) {
      for (let k = 0; k < 4; k += 1) {
        const p = cells[c + k], f = cells[c + ((k + 1) & 3)], g = cells[c + ((k + 3) & 3)];
        const ax = x[f] - x[p], ay = y[f] - y[p], bx = x[g] - x[p], by = y[g] - y[p];
        const cx = x0[f] - x0[p], cy = y0[f] - y0[p], dx = x0[g] - x0[p], dy = y0[g] - y0[p];
        const det0 = cx * dy - cy * dx, det = ax * by - ay * bx;
        const k00 = dy / det0, k01 = -dx / det0, k10 = -cy / det0, k11 = cx / det0;
        const a00 = ax * k00 + bx * k10, a01 = ax * k01 + bx * k11, a10 = ay * k00 + by * k10, a11 = ay * k01 + by * k11;
        const inverse = det0 / det;
        const r = 0.5 * (a00 * a00 + a01 * a01 + a10 * a10 + a11 * a11) * inverse;
        const na = by / det, ma = -bx / det, nb = -ay / det, mb = ax / det;
        const ga = (a00 * k00 + a01 * k01) * inverse - r * na, ha = (a10 * k00 + a11 * k01) * inverse - r * ma;
        const gb = (a00 * k10 + a01 * k11) * inverse - r * nb, hb = (a10 * k10 + a11 * k11) * inverse - r * mb;
        addCorner(f, scale, r, ga, ha, na, ma, (k00 * k00 + k01 * k01) * inverse);
        addCorner(g, scale, r, gb, hb, nb, mb, (k10 * k10 + k11 * k11) * inverse);
        addCorner(p, scale, r, -ga - gb, -ha - hb, -na - nb, -ma - mb, ((k00 + k10) ** 2 + (k01 + k11) ** 2) * inverse);
        total += 0.5 * (r * r - 1);
      }
    }
    return total;
  }

  function addCorner(node, scale, r, g, h, a, b, curve) {
    sums[5 * node] += scale * r * g;
    sums[5 * node + 1] += scale * r * h;
    sums[5 * node + 2] += scale * (r * curve + 2 * r * r * a * a + g * g);
    sums[5 * node + 3] += scale * (2 * r * r * a * b + g * h);
    sums[5 * node + 4] += scale * (r * curve + 2 * r * r * b * b + h * h);
  }

  return {
    cells: count,
    smallestShare: (mesh) => (cutsOff(mesh) ? 0 : smallestShare(placesOf(domain, mesh), first, cells)),
    error(mesh) {
      const [x, y] = placesOf(domain, mesh);
      const square = squaredError(x, y);
      return square >= 0 && square < Infinity ? Math.sqrt(square) : Infinity;
    },
    /** Value and derivatives at a mesh; null where a Jacobian is not over the floor, or u not finite. */
    evaluate(mesh, floor = null) {
      const places = placesOf(domain, mesh);
      const [x, y] = places;
      if (!(smallestShare(places, first, cells) > (floor ?? 0)) || (floor !== null && cutsOff(mesh))) return null;
      const square = squaredError(x, y);
      if (!(square > 0 && square < Infinity)) return null;
      const mean = distortion(x, y, (2 * square * weight.distortion) / (4 * count)) / (4 * count);
      if (!Number.isFinite(mean)) return null;
      const derivatives = pulledDerivatives(sums, 0.5 / square, domain.isIdentity ? null : places);
      const bends = addBends(mesh, start, [n, m], weight.smoothness, stiffness, derivatives);
      return { value: 0.5 * Math.log(square) + weight.distortion * mean + weight.smoothness * bends, error: Math.sqrt(square), ...derivatives };
    },
  };
}

// The derivatives by s and t, `{gradient, blocks}`, flat arrays of two and three per node, from the sums by x and y.
function pulledDerivatives(sums, factor, map) {
  const size = sums.length / 5;
  const gradient = new Float64Array(2 * size), blocks = new Float64Array(3 * size);
  for (let k = 0; k < size; k += 1) {
    const g = sums[5 * k], h = sums[5 * k + 1], a = sums[5 * k + 2], b = sums[5 * k + 3], d = sums[5 * k + 4];
    const x_s = map ? map[2][k] : 1, x_t = map ? map[3][k] : 0, y_s = map ? map[4][k] : 0, y_t = map ? map[5][k] : 1;
    gradient[k] = factor * (g * x_s + h * y_s);
    gradient[size + k] = factor * (g * x_t + h * y_t);
    blocks[3 * k] = factor * (a * x_s * x_s + 2 * b * x_s * y_s + d * y_s * y_s);
    blocks[3 * k + 1] = factor * (a * x_s * x_t + b * (x_s * y_t + x_t * y_s) + d * y_s * y_t);
    blocks[3 * k + 2] = factor * (a * x_t * x_t + 2 * b * x_t * y_t + d * y_t * y_t);
  }
  return { gradient, blocks };
}

// Half the sum of squared second differences along all lines; adds its derivatives, and holds nodes to their sides.
function addBends({ s, t }, start, [n, m], weight, stiffness, { gradient, blocks }) {
  let total = 0;
  [[s, start.s, 0], [t, start.t, n * m]].forEach(([now, before, offset]) => {
    eachTriple(n, m, (a, b, c) => {
      const bend = now[a] - before[a] - 2 * (now[b] - before[b]) + now[c] - before[c];
      total += bend * bend;
      gradient[offset + a] += weight * bend;
      gradient[offset + b] -= 2 * weight * bend;
      gradient[offset + c] += weight * bend;
    });
  });
  for (let i = 0, k = 0; i < n; i += 1) for (let j = 0; j < m; j += 1, k += 1) {
    const isEnd = i === 0 || i === n - 1, isSide = j === 0 || j === m - 1;
    if (isEnd) gradient[k] = 0;
    if (isSide) gradient[n * m + k] = 0;
    if (isEnd || isSide) blocks[3 * k + 1] = 0;
    blocks[3 * k] += weight * stiffness[k];
    blocks[3 * k + 2] += weight * stiffness[k];
  }
  return 0.5 * total;
}

function eachTriple(n, m, visit) {
  for (let i = 0; i < n; i += 1) for (let j = 0; j < m; j += 1) {
    const k = i * m + j;
    if (i > 0 && i < n - 1) visit(k - m, k, k + m);
    if (j > 0 && j < m - 1) visit(k - 1, k, k + 1);
  }
}

function stiffnessOf(n, m) {
  const out = new Float64Array(n * m);
  eachTriple(n, m, (a, b, c) => {
    out[a] += 1;
    out[b] += 4;
    out[c] += 1;
  });
  return out;
}

// The area between the sides of the domain and the edges of cells there, by Simpson's rule.
function cutOff(domain, mesh, [n, m]) {
  const places = [];
  const add = (k, l) => [0, 0.25, 0.5, 0.75, 1].forEach((share) => places.push([k, l, share]));
  for (let i = 0; i < n - 1; i += 1) for (const j of [0, m - 1]) add(i * m + j, (i + 1) * m + j);
  for (let j = 0; j < m - 1; j += 1) for (const i of [0, n - 1]) add(i * m + j, i * m + j + 1);
  const at = (values) => Float64Array.from(places, ([k, l, share]) => (1 - share) * values[k] + share * values[l]);
  const [x, y] = domain.map(at(mesh.s), at(mesh.t));
  let total = 0;
  for (let k = 0; k < places.length; k += 5) {
    const dx = x[k + 4] - x[k], dy = y[k + 4] - y[k];
    const height = (q) => Math.abs((x[k + q] - x[k]) * dy - (y[k + q] - y[k]) * dx);
    total += height(1) / 3 + height(2) / 6 + height(3) / 3;
  }
  return total;
}

const boundOfCutOff = (first, scale, area) => first + Math.max(first, MORE_CUT_OFF * scale * area);

const dot = (a, b) => {
  let sum = 0;
  for (let k = 0; k < a.length; k += 1) sum += a[k] * b[k];
  return sum;
};

// L-BFGS from the 2 x 2 blocks of the nodes.
function createHistory() {
  let pairs = [];
  function solved(blocks, right) {
    const size = right.length / 2;
    const out = new Float64Array(right.length);
    for (let k = 0; k < size; k += 1) {
      const a = blocks[3 * k], b = blocks[3 * k + 1], d = blocks[3 * k + 2], one = right[k], other = right[size + k];
      const det = a * d - b * b;
      out[k] = (d * one - b * other) / det;
      out[size + k] = (a * other - b * one) / det;
    }
    return out;
  }
  return {
    get isEmpty() { return pairs.length === 0; },
    clear() { pairs = []; },
    add(move, change) {
      const mixed = dot(move, change);
      if (mixed > 1e-12 * Math.sqrt(dot(move, move) * dot(change, change))) pairs = [...pairs.slice(1 - PAIRS), { move, change, mixed }];
    },
    direction(gradient, blocks) {
      const rest = gradient.slice();
      const shares = pairs.map(() => 0);
      for (let p = pairs.length - 1; p >= 0; p -= 1) {
        const { move, change, mixed } = pairs[p];
        shares[p] = dot(move, rest) / mixed;
        for (let k = 0; k < rest.length; k += 1) rest[k] -= shares[p] * change[k];
      }
      const out = solved(blocks, rest);
      if (!pairs.length) return out;
      const { change: last, mixed: lastMixed } = pairs.at(-1);
      const scale = lastMixed / dot(last, solved(blocks, last));
      for (let k = 0; k < out.length; k += 1) out[k] *= scale;
      pairs.forEach(({ move, change, mixed }, p) => {
        const share = shares[p] - dot(change, out) / mixed;
        for (let k = 0; k < out.length; k += 1) out[k] += share * move[k];
      });
      return out;
    },
  };
}

const joined = ({ s, t }) => {
  const out = new Float64Array(2 * s.length);
  out.set(s);
  out.set(t, s.length);
  return out;
};
const parted = (flat) => ({ s: flat.slice(0, flat.length / 2), t: flat.slice(flat.length / 2) });

// The meshes of a descent from a mesh, with their errors; none where the objective has no value there.
function* descend(objective, mesh, steps) {
  let now = objective.evaluate(mesh);
  if (!now) return;
  let flat = joined(mesh);
  const history = createHistory();
  const floor = Math.min(LEAST_SHARE, 0.9 * objective.smallestShare(mesh));
  const values = [now.value];
  let { blocks } = now;

  function search() {
    const direction = history.direction(now.gradient, blocks);
    const slope = dot(now.gradient, direction);
    const longest = direction.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
    if (!(slope > 0 && longest < Infinity)) return null;
    let length = Math.min(1, MOST_MOVE / Math.sqrt(objective.cells) / longest);
    for (let trial = 0; trial < MOST_TRIALS; trial += 1) {
      const moved = flat.map((one, k) => one - length * direction[k]);
      const then = objective.evaluate(parted(moved), floor);
      if (then && then.value <= now.value - 1e-4 * length * slope) return [moved, then];
      length *= SHORTENING;
    }
    return null;
  }

  for (let step = 0; step < steps; step += 1) {
    if (step % STEPS_A_PRECONDITIONER === 0) blocks = now.blocks;
    let found = search();
    if (!found && !history.isEmpty) {
      history.clear();
      blocks = now.blocks;
      found = search();
    }
    if (!found) return;
    const [moved, then] = found;
    const before = now;
    history.add(moved.map((one, k) => one - flat[k]), then.gradient.map((one, k) => one - before.gradient[k]));
    [flat, now] = [moved, then];
    yield { mesh: parted(flat), error: now.error };
    values.push(now.value);
    if (values.length > PATIENCE && values.at(-1 - PATIENCE) - now.value < PATIENCE * LEAST_DECREASE) return;
  }
}

/**
 * The steps of the mesh with the least error of interpolating u: each yields `{mesh, shape, isLast}`.
 *
 * It is the solver's descent on nested meshes, with its default weights, from the uniform mesh and from straight lines.
 * The last mesh is never worse than the uniform one.  `start`, a mesh of these points, is where the descent begins in
 * place of both: for a formula that has changed a little, this takes a few steps.
 *
 * @param {object} u of `compile`
 * @param {number[]} shape
 * @param {object} domain of `domainOf`
 * @param {{start?: {s: Float64Array, t: Float64Array}, steps?: number}} [settings]
 */
export function* leastError(u, shape, domain, { start = null, steps = Infinity } = {}) {
  const levels = levelsOf(shape);
  const finestCells = (shape[0] - 1) * (shape[1] - 1);
  const known = new Map();

  function objectiveOf(level, firstMesh, points = upTo(POINTS, level[0] * level[1], 2)) {
    const key = [level, points].join(" ");
    if (!known.has(firstMesh)) known.set(firstMesh, new Map());
    const own = known.get(firstMesh);
    if (!own.has(key)) own.set(key, createObjective(u, domain, level, firstMesh(...level), uniform(...level), points, finestCells));
    return own.get(key);
  }

  function* descent(level, firstMesh, mesh) {
    let last = { mesh, error: Infinity };
    const most = Math.min(steps, upTo(STEPS, level[0] * level[1], 1));
    for (last of descend(objectiveOf(level, firstMesh), mesh, most)) yield { mesh: last.mesh, shape: level, isLast: false };
    return { mesh: last.mesh, firstMesh };
  }

  function lifted({ mesh, firstMesh }, from, to) {
    const fine = liftedMesh(mesh, from, to, firstMesh);
    const error = objectiveOf(to, firstMesh).error(fine);
    if (firstMesh === uniform) return { mesh: fine, firstMesh, error };
    const straight = objectiveOf(to, firstMesh).error(firstMesh(...to));
    return error <= MOST_LIFTED * straight ? { mesh: fine, firstMesh, error } : { mesh: firstMesh(...to), firstMesh, error: straight };
  }

  let reached;
  if (start) reached = yield* descent(shape, uniform, start);
  else {
    const last = Math.max(0, levels.findLastIndex(([n, m]) => n * m <= MOST_COMPARED));
    const ends = [];
    for (const firstMesh of startsOf(u, domain, levels[last], shape, objectiveOf)) {
      let end = yield* descent(levels[0], firstMesh, firstMesh(...levels[0]));
      for (let k = 1; k <= last; k += 1) end = yield* descent(levels[k], firstMesh, lifted(end, levels[k - 1], levels[k]).mesh);
      ends.push(end);
    }
    const next = levels[Math.min(last + 1, levels.length - 1)];
    const measured = ends.map((end) => (next === levels[last] ? { ...end, error: objectiveOf(next, end.firstMesh).error(end.mesh) } : lifted(end, levels[last], next)));
    reached = measured.reduce((best, one) => (one.error < best.error ? one : best));
    for (let k = last + 1; k < levels.length; k += 1) {
      if (k > last + 1) reached = lifted(reached, levels[k - 1], levels[k]);
      reached = yield* descent(levels[k], reached.firstMesh, reached.mesh);
    }
  }
  const plain = uniform(...shape);
  const isBetter = errorOf(u, domain, reached.mesh, shape).l2 <= errorOf(u, domain, plain, shape).l2;
  yield { mesh: isBetter ? reached.mesh : plain, shape, isLast: true };
}

// The starts that are compared: the uniform mesh, and the best one of straight lines where that is better.
function* startsOf(u, domain, level, shape, objectiveOf) {
  yield uniform;
  const objective = objectiveOf(level, uniform);
  let best = null, least = objective.error(uniform(...level));
  if (!(least > 0)) return;
  for (const floor of [1, 0.1, 0.01]) {
    const firstMesh = straightLines(u, domain, shape.map((points) => Math.min(points, 17)), floor);
    if (!firstMesh) continue;
    const mesh = firstMesh(...level);
    const error = objective.smallestShare(mesh) > 0 ? objective.error(mesh) : Infinity;
    if (error < least) [best, least] = [floor, error];
  }
  const found = best === null ? null : straightLines(u, domain, shape, best);
  if (found) yield found;
}

const PASSES = 8;
const SETTLED_LINES = 0.05;
const MOST_CROSSINGS = 33;

// Lines of both families at equal integrals of the density of least error; a function that gives their mesh on a grid.
function straightLines(u, domain, counts, floor) {
  let lines = counts.map(linspace);
  for (let pass = 0; pass < PASSES; pass += 1) {
    const few = lines.map((line) => resampled(line, Math.min(line.length, MOST_CROSSINGS)));
    const moved = [];
    for (const axis of [0, 1]) {
      const slopes = slopesAlong(axis, u, domain, lines[axis], few[1 - axis]);
      if (!slopes) return null;
      moved.push(equidistributed(lines[axis], slopes, sharesOf(few[1 - axis]), floor));
    }
    const change = Math.max(...moved.map((line, axis) => largestChange(lines[axis], line)));
    lines = moved;
    if (change < SETTLED_LINES) break;
  }
  return (n, m) => product(resampled(lines[0], n), resampled(lines[1], m));
}

function resampled(line, count) {
  if (line.length === count) return line;
  return Float64Array.from({ length: count }, (_, k) => {
    const at = (k * (line.length - 1)) / (count - 1);
    const cell = Math.min(Math.floor(at), line.length - 2);
    return line[cell] + (at - cell) * (line[cell + 1] - line[cell]);
  });
}

const sharesOf = (line) => line.map((one, k) => (k === 0 ? line[1] - one : k === line.length - 1 ? one - line[k - 1] : (line[k + 1] - line[k - 1]) / 2));

// The derivatives of u along a family where the other crosses, lines times crossings; null where they are not finite.
function slopesAlong(axis, u, domain, line, crossings) {
  const size = line.length * crossings.length;
  const own = Float64Array.from({ length: size }, (_, k) => line[Math.floor(k / crossings.length)]);
  const other = Float64Array.from({ length: size }, (_, k) => crossings[k % crossings.length]);
  const [x, y, x_s, x_t, y_s, y_t] = placesOf(domain, axis === 0 ? { s: own, t: other } : { s: other, t: own });
  const [, u_x, u_y] = u.evaluate(x, y);
  const along = domain.isIdentity ? (axis === 0 ? u_x : u_y).slice() : u_x.map((one, k) => (axis === 0 ? one * x_s[k] + u_y[k] * y_s[k] : one * x_t[k] + u_y[k] * y_t[k]));
  return along.every(Number.isFinite) ? along : null;
}

function equidistributed(line, slopes, shares, floor) {
  const cells = line.length - 1, crossings = shares.length;
  const largest = slopes.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
  const bends = new Float64Array(cells * crossings);
  for (let k = 0; k < bends.length; k += 1) {
    const change = slopes[k + crossings] - slopes[k];
    const i = Math.floor(k / crossings);
    if (Math.abs(change) > 1e-13 * largest) bends[k] = change / (line[i + 1] - line[i]);
  }
  const size = bends.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
  if (!(size > 0)) return line;
  const density = Float64Array.from({ length: cells }, (_, i) => shares.reduce((sum, share, k) => sum + (bends[i * crossings + k] / size) ** 2 * share, 0) ** 0.2);
  const mean = density.map((one, i) => 0.25 * density[Math.max(i - 1, 0)] + 0.5 * one + 0.25 * density[Math.min(i + 1, cells - 1)]);
  const total = mean.reduce((sum, one, i) => sum + one * (line[i + 1] - line[i]), 0);
  const integral = new Float64Array(line.length);
  for (let i = 0; i < cells; i += 1) integral[i + 1] = integral[i] + (mean[i] + floor * total) * (line[i + 1] - line[i]);
  let cell = 0;
  const moved = line.map((_, k) => {
    const at = (integral[cells] * k) / cells;
    while (cell < cells - 1 && integral[cell + 1] < at) cell += 1;
    return line[cell] + ((at - integral[cell]) / (integral[cell + 1] - integral[cell])) * (line[cell + 1] - line[cell]);
  });
  [moved[0], moved[cells]] = [0, 1];
  return moved;
}

function largestChange(old, line) {
  const step = (k) => (k < 0 || k >= old.length - 1 ? Infinity : old[k + 1] - old[k]);
  return line.reduce((most, one, k) => Math.max(most, Math.abs(one - old[k]) / Math.min(step(k - 1), step(k))), 0);
}

/**
 * Compares meshes of u with the uniform one: a function of a mesh on any grid of the same kind that gives a preview,
 * with nodes, u and the error of both meshes, their norms `l2` and `l2Uniform`, and the `gain`.
 *
 * Throws a `FormulaError` where u is not finite.  A mesh with fewer points is interpolated.  Where it is folded on the domain the uniform mesh is shown in its place.
 *
 * @param {object} u of `compile`
 * @param {object} domain of `domainOf`
 * @param {number[]} shape
 */
export function comparison(u, domain, shape) {
  const plain = uniform(...shape);
  const [uniformX, uniformY] = placesOf(domain, plain);
  const before = errorOf(u, domain, plain, shape);
  if (!Number.isFinite(before.l2)) throw new FormulaError("u is not finite everywhere on the domain: keep away from its singular points");
  const valuesAt = (x, y) => u.values(x, y).slice();
  const uniformU = valuesAt(uniformX, uniformY);
  const cells = cellsOf(...shape);
  return ({ mesh, shape: own = shape }) => {
    const given = String(own) === String(shape) ? mesh : liftedMesh(mesh, own, shape, uniform);
    const isValid = smallestShare(placesOf(domain, given), [uniformX, uniformY], cells) > 0;
    const shown = isValid ? given : plain;
    const [x, y] = placesOf(domain, shown);
    const after = shown === plain ? before : errorOf(u, domain, shown, shape);
    return {
      mesh: shown, shape, x, y, uniformX, uniformY, u: valuesAt(x, y), uniformU,
      error: after.cells, uniformError: before.cells, l2: after.l2, l2Uniform: before.l2,
      gain: after.l2 > 0 ? before.l2 / after.l2 : 1,
    };
  };
}
