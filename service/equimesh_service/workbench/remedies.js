// What a visitor can do about a problem, as buttons that do it.

import { hasBlocks } from "./sides.js";
import { START } from "./store.js";

// The points a side of the service, where a spec says nothing.
const USUAL = 64;
// The fewest points a side that "fewer points" leads to.
const FEWEST = 17;

/** Whether the remedy of a problem is to request the mesh, as it is too much for a preview. */
export function isForMeshes({ type = "", detail = "", errors = [], isOfMesh = false }) {
  if (isOfMesh) return false; // it is one
  return /time-limit|preview/.test(type) || /preview/i.test([detail, ...errors.map(({ message }) => message)].join(" "));
}

/**
 * The remedies of a problem: `{text, spec}` with the spec that it leads to, or `{text, request: true}` for the mesh
 * itself in place of a preview.
 *
 * @param {object} problem of the service
 * @param {object} spec that has it
 * @returns {{text: string, spec?: object, request?: boolean}[]}
 */
export function remediesOf(problem, spec) {
  const kind = (problem.type ?? "").split("/").at(-1);
  const pointers = (problem.errors ?? []).map(({ pointer }) => pointer ?? "");
  if (isForMeshes(problem)) return [{ text: "Compute it to its end", request: true }, ...fewerPoints(spec)];
  if (kind === "time-limit" || kind === "memory-limit") return fewerPoints(spec);
  if (kind === "not-converged" && spec.schwarz) return moreIterations(spec);
  if (kind === "folded" || kind === "newton-failed") return [...automatic(spec), ...fewerPoints(spec)];
  if (pointers.some((pointer) => pointer.startsWith("/grid"))) return [usualGrid(spec)];
  if (pointers.some((pointer) => /^\/(monitor|domain)(\/kind)?$/.test(pointer) || pointer === "")) {
    return [{ text: "Begin with the first problem", spec: START.spec }];
  }
  return [];
}

/** A problem in one sentence: its faults, or its detail. */
export function sentenceOf(problem) {
  if (isForMeshes(problem)) return "This mesh has more points, or takes longer, than a preview may.";
  const faults = (problem.errors ?? []).filter(({ message }) => message).map(named);
  if (faults.length) return faults.join(" ");
  return problem.detail ?? problem.title ?? "The service refused this.";
}

// A fault with the name of its key.
function named({ pointer = "", message }) {
  const name = pointer.split("/").at(-1);
  return name ? message.replace(/^this key/, `the key '${name}'`) : message;
}

function usualGrid({ grid: _, ...spec }) {
  if (hasBlocks(spec.domain)) return { text: "Take the cells of the blocks", spec };
  const { n_xi: n, n_eta: m } = START.spec.grid;
  return { text: `Take ${n} × ${m} points`, spec: { ...spec, grid: { n_xi: n, n_eta: m } } };
}

function fewerPoints(spec) {
  if (spec.target || !["rectangle", "annulus_sector", "quadrilateral", undefined].includes(spec.domain?.kind)) return [];
  const { n_xi: n = USUAL, n_eta: m = USUAL } = spec.grid ?? {};
  const half = (number) => Math.max(Math.min(number, FEWEST), Math.ceil(number / 2));
  const grid = { n_xi: half(n), n_eta: half(m) };
  if (grid.n_xi === n && grid.n_eta === m) return [];
  return [{ text: `Take ${grid.n_xi} × ${grid.n_eta} points`, spec: { ...spec, grid } }];
}

function moreIterations(spec) {
  const most = 3 * (spec.schwarz.max_iterations ?? 100);
  const more = { text: `Allow ${most} iterations`, spec: { ...spec, schwarz: { ...spec.schwarz, max_iterations: most } } };
  const { transmission, ...rest } = spec.schwarz;
  const isOptimized = (transmission?.kind ?? "optimized") === "optimized";
  return isOptimized ? [more] : [{ text: "Take the optimized condition", spec: { ...spec, schwarz: rest } }, more];
}

function automatic(spec) {
  const { u, kind } = spec.monitor ?? {};
  if (!u || kind === undefined || kind === "auto") return [];
  return [{ text: "Take the automatic monitor", spec: { ...spec, monitor: { u } } }];
}

/**
 * The remedies as buttons of a notice.
 *
 * @param {object} app
 * @param {object} problem
 */
export function actionsOf(app, problem) {
  return remediesOf(problem, app.store.get().spec).map(({ text, spec, request }) => ({
    text,
    act: () => (request ? app.emit("request", null) : app.change({ spec })),
  }));
}
