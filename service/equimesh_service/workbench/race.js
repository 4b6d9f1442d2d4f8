// Two Schwarz iterations next to each other, from the same start: the optimized condition and the classical one.

// The moves of the slower iteration are drawn as large as this power of them says, in units of the first one.
const POWER = 0.5;
// From one iterate to the next the magnification grows by this factor at most.
const GROWTH = 1.6;
// Halvings of a magnification that folds a cell.
const MOST_HALVINGS = 12;
// The most iterations of the classical condition.
const MOST_ITERATIONS = 400;
// Kinds of monitors that are solved on subdomains as they are; in place of others the arc length of u is taken.
const KINDS = new Set(["arc_length", "curvature", "weight", "tensor", "intersection"]);

/**
 * A spec whose iteration can be watched: few points, from the uniform mesh, on 2 x 2 subdomains, without what speeds an
 * iteration up.
 *
 * @param {object} spec with a u, or with a monitor that needs none
 */
export function exampleOf({ monitor = {}, domain }) {
  const { kind, u } = monitor;
  return {
    monitor: KINDS.has(kind) ? monitor : { kind: "arc_length", u },
    ...(domain ? { domain } : {}),
    grid: { n_xi: 17, n_eta: 17 },
    initial: "uniform",
    schwarz: { subdomains: [2, 2], overlap: 3, acceleration: "none", line_correction: 0, tolerance: 1e-5 },
  };
}

/** The same iteration with the classical condition. */
export function classicalOf(spec) {
  const schwarz = { ...spec.schwarz, transmission: { kind: "classical" }, fallback: false, max_iterations: MOST_ITERATIONS };
  return { ...spec, schwarz };
}

/** Whether a spec has an iteration that the classical one can be compared with. */
export const hasRival = ({ schwarz, monitor }) => Boolean(schwarz) && monitor?.kind !== "least_error" && schwarz.transmission?.kind !== "classical";

/** Two iterations by their drawings with frames; `at(position)` is what is seen of both. */
export class Race {
  constructor(optimized, classical) {
    this.sides = [classical, optimized].map(sideOf);
    this.last = Math.max(...this.sides.map(({ numbers }) => numbers.at(-1)));
    const { frames, shape } = this.sides[1];
    this.limit = frames.at(-1);
    this.shape = shape;
    this.factors = factorsOf(this.sides, this.limit, this.last, shape);
  }

  /**
   * Both iterations at a position between two iterates: `{nodes, factor, done}`.
   *
   * `nodes` are [x, y] of the classical and of the optimized iteration, with their distance from the limit `factor`
   * times larger; `done` says of both whether they have ended.
   */
  at(position) {
    const before = Math.floor(position);
    const share = position - before;
    const [one, other] = [before, Math.min(before + 1, this.last)].map((k) => this.factors[k]);
    const factor = one + share * (other - one);
    const nodes = this.sides.map((side) => magnified(nodesOf(side, position), this.limit, factor));
    return { nodes, factor, done: this.sides.map(({ numbers }) => position >= numbers.at(-1)) };
  }
}

// The frames of a drawing, as pairs of coordinates, with the numbers of their iterations.
function sideOf({ arrays: { frames_x: xs, frames_y: ys }, document }) {
  const [count, rows, columns] = xs.shape;
  const size = rows * columns;
  const cut = ({ data }, k) => data.subarray(k * size, (k + 1) * size);
  const numbers = document.frames ?? Array.from({ length: count }, (_, k) => k);
  return { numbers, shape: [rows, columns], frames: Array.from({ length: count }, (_, k) => [cut(xs, k), cut(ys, k)]) };
}

// The nodes at a position: on the straight way between two frames, and at the last one after it.
function nodesOf({ numbers, frames }, position) {
  const next = numbers.findIndex((number) => number >= position);
  if (next < 0) return frames.at(-1);
  if (next === 0) return frames[0];
  const share = (position - numbers[next - 1]) / (numbers[next] - numbers[next - 1]);
  return [0, 1].map((axis) => frames[next][axis].map((value, k) => (1 - share) * frames[next - 1][axis][k] + share * value));
}

function magnified(nodes, limit, factor) {
  return nodes.map((values, axis) => Float64Array.from(values, (value, k) => limit[axis][k] + factor * (value - limit[axis][k])));
}

/** How much larger the distance from the limit is drawn in each iteration: 1 at the start, and never so that cells fold. */
function factorsOf(sides, limit, last, shape) {
  const distance = (nodes) => Math.max(...nodes.map((values, axis) => values.reduce((most, value, k) => Math.max(most, Math.abs(value - limit[axis][k])), 0)));
  const first = distance(sides[0].frames[0]) || 1;
  const factors = [1];
  for (let k = 1; k <= last; k += 1) {
    const both = sides.map((side) => nodesOf(side, k));
    const far = Math.max(...both.map(distance));
    let factor = far > 0 ? Math.min((first / far) ** (1 - POWER), GROWTH * factors[k - 1]) : factors[k - 1];
    for (let tries = 0; tries < MOST_HALVINGS && factor > 1 && both.some((nodes) => isFolded(magnified(nodes, limit, factor), shape)); tries += 1) {
      factor = Math.max(1, factor / 2);
    }
    factors.push(factor);
  }
  return factors;
}

/** Whether a cell of a grid has an area that is not positive, at one of its corners. */
export function isFolded([x, y], [rows, columns]) {
  const turn = (a, b, c) => (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]);
  for (let i = 0; i < rows - 1; i += 1) {
    for (let j = 0; j < columns - 1; j += 1) {
      const [a, b, c, d] = [i * columns + j, (i + 1) * columns + j, (i + 1) * columns + j + 1, i * columns + j + 1];
      if (Math.min(turn(a, b, d), turn(b, c, a), turn(c, d, b), turn(d, a, c)) <= 0) return true;
    }
  }
  return false;
}
