// The meshes between two Schwarz iterates: the subdomains move to their next place one after another.

/**
 * The turns of an iteration: which subdomains are solved at the same time, in their order.
 *
 * @param {{xi: number[], eta: number[]}[]} subdomains first and last point of each along both axes
 * @param {string} ordering parallel, alternating, symmetric or coloured
 * @returns {number[][]} numbers of subdomains, turn by turn
 */
export function turnsOf(subdomains, ordering) {
  const numbers = subdomains.map((_, number) => number);
  if (ordering === "parallel") return [numbers];
  if (ordering === "coloured") return colours(subdomains);
  const forward = numbers.map((number) => [number]);
  return ordering === "symmetric" ? [...forward, ...forward.slice(0, -1).reverse()] : forward;
}

// Every other subdomain along xi and along eta, as the solver groups them.
function colours(subdomains) {
  const place = (axis) => {
    const firsts = [...new Set(subdomains.map((one) => one[axis][0]))].sort((a, b) => a - b);
    return subdomains.map((one) => firsts.indexOf(one[axis][0]));
  };
  const [alongXi, alongEta] = [place("xi"), place("eta")];
  const found = new Map();
  subdomains.forEach((_, number) => {
    const colour = 2 * (alongXi[number] % 2) + (alongEta[number] % 2);
    found.set(colour, [...(found.get(colour) || []), number]);
  });
  return [...found.keys()].sort((a, b) => a - b).map((colour) => found.get(colour));
}

/**
 * The steps that are shown: step 0 is the start. Subdomains of a parallel turn are shown one after another.
 *
 * Only merged meshes are known, one an iteration. So a subdomain that is solved twice moves in its last turn.
 *
 * @param {number} iterations how many iterations there are
 * @param {number[][]} turns of one iteration
 * @param {boolean} isParallel whether all are solved at the same time
 * @returns {{iteration: number, active: number[], moving: number[], moved: number[]}[]} for each step the subdomains that
 *   are solved, those of them that move, and those that have moved before
 */
export function stepsOf(iterations, turns, isParallel) {
  const shown = isParallel ? turns.flat().map((number) => [number]) : turns;
  const lastTurn = new Map();
  shown.forEach((active, turn) => active.forEach((number) => lastTurn.set(number, turn)));
  const numbers = [...lastTurn.keys()];
  const steps = [{ iteration: 0, active: [], moving: [], moved: [] }];
  for (let iteration = 1; iteration <= iterations; iteration += 1) {
    shown.forEach((active, turn) => {
      const moving = active.filter((number) => lastTurn.get(number) === turn);
      const moved = numbers.filter((number) => lastTurn.get(number) < turn);
      steps.push({ iteration, active, moving, moved });
    });
  }
  return steps;
}

/**
 * The nodes in the course of a step: a part of the grid is at the iterate before, a part at the iterate after.
 *
 * @param {Float32Array} before one coordinate of the nodes of the iterate before
 * @param {Float32Array} after the same of the iterate after
 * @param {{moving: number[], moved: number[]}} step one of `stepsOf`
 * @param {{xi: number[], eta: number[]}[]} subdomains first and last point of each
 * @param {number} columns points along eta
 * @param {number} share how much of the step is done, 0 to 1
 * @returns {Float64Array} the coordinate of all nodes
 */
export function mixed(before, after, step, subdomains, columns, share) {
  const found = Float64Array.from(before);
  const move = (number, weight) => {
    const { xi, eta } = subdomains[number];
    for (let i = xi[0]; i <= xi[1]; i += 1) {
      for (let j = eta[0]; j <= eta[1]; j += 1) {
        const at = i * columns + j;
        found[at] = before[at] + weight * (after[at] - before[at]);
      }
    }
  };
  step.moving.forEach((number) => move(number, share));
  // After the others, as the overlap of a subdomain that has moved stays where it is.
  step.moved.forEach((number) => move(number, 1));
  return found;
}

/**
 * The nodes around a subdomain, in order, as a closed line.
 *
 * @param {{xi: number[], eta: number[]}} subdomain first and last point along both axes
 * @param {number} columns points along eta
 * @returns {number[]} indices of nodes
 */
export function outlineOf({ xi, eta }, columns) {
  const nodes = [];
  for (let i = xi[0]; i < xi[1]; i += 1) nodes.push(i * columns + eta[0]);
  for (let j = eta[0]; j < eta[1]; j += 1) nodes.push(xi[1] * columns + j);
  for (let i = xi[1]; i > xi[0]; i -= 1) nodes.push(i * columns + eta[1]);
  for (let j = eta[1]; j > eta[0]; j -= 1) nodes.push(xi[0] * columns + j);
  return nodes;
}
