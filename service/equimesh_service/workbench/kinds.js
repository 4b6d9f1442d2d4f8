// The kinds of monitors with their settings, in the words of the page.

import { choiceField, flagField, numberField } from "./bound.js";

/** The settings of monitors: how each one is shown, and its default. */
export const SETTINGS = {
  norm: {
    field: choiceField,
    label: "Error to make small",
    fallback: "l2",
    choices: [["l2", "of u (L2)"], ["h1", "of its gradient (H1)"]],
  },
  for: {
    field: choiceField,
    label: "Chosen for",
    fallback: null,
    choices: [["", "interpolation of u"], ["finite_volume", "finite volumes: a cell-centred code"]],
  },
  distortion: {
    field: numberField,
    label: "Distortion",
    fallback: 0.5,
    min: 0,
    help: "Weight of deformed cells; less for a smaller error.",
  },
  smoothness: {
    field: numberField,
    label: "Smoothness",
    fallback: 1,
    min: 0,
    help: "Weight of uneven neighbours; less for a smaller error.",
  },
  rectilinear: { field: flagField, label: "Rectilinear", fallback: false, help: "Keep all mesh lines straight." },
  a: { field: numberField, label: "Strength a", fallback: 0.7, min: 0, max: 1, help: "0 gives the uniform mesh." },
  b: { field: numberField, label: "Damping b", fallback: 0.05, min: 0, help: "Larger for smoother meshes." },
  scaled: {
    field: flagField,
    label: "Scaled",
    fallback: true,
    help: "u in units of its range, lengths in units of the domain. Off is the formula of the paper.",
  },
  isotropic: { field: flagField, label: "Isotropic", fallback: false, help: "Small cells that are not stretched." },
  map: {
    field: choiceField,
    label: "Map",
    fallback: "lines",
    choices: [["lines", "equal lengths along mesh lines"], ["gradient", "equal shares of area, by a gradient"]],
  },
  smoothing: {
    field: numberField,
    label: "Smoothing",
    fallback: 0,
    min: 0,
    max: 0.25,
    help: "Radius over which the metric is averaged, as a share of the domain: 0 to 0.25.",
  },
  orthogonality: {
    field: numberField,
    label: "Largest angle",
    optional: true,
    min: 0,
    max: 90,
    placeholder: "none",
    help: "Degrees between the normal of a face and the line of its two cell centres.",
  },
};

/** The kinds: a title, the settings that most people change, the others, and the functions besides u. */
export const KINDS = {
  auto: { title: "Automatic", common: ["norm"], more: ["for", "orthogonality"] },
  least_error: {
    title: "Least error",
    common: ["norm"],
    more: ["distortion", "smoothness", "rectilinear", "orthogonality"],
  },
  arc_length: { title: "Arc length", common: ["a", "b"], more: ["scaled", "smoothing", "orthogonality"] },
  curvature: { title: "Curvature", common: ["norm", "smoothing"], more: ["isotropic", "orthogonality"] },
  weight: { title: "Weight", functions: ["rho"], common: ["map"], more: ["smoothing", "orthogonality"] },
  tensor: { title: "Tensor", functions: ["m11", "m12", "m22"], common: [], more: ["smoothing", "orthogonality"] },
  intersection: { title: "Intersection of several", common: [], more: ["smoothing", "orthogonality"] },
  nodal_solution: { title: "Values at nodes", common: ["norm"], more: ["orthogonality"] },
};

/** The kinds that a member of an intersection can have. */
export const MEMBER_KINDS = ["arc_length", "curvature", "weight", "tensor"];

/** The functions that a kind needs besides u, until they are changed. */
export const FIRST_FUNCTIONS = {
  rho: "1 + 20*exp(-50*(x - 0.5)**2)",
  m11: "1 + 100*exp(-50*(x - 0.5)**2)",
  m12: "0",
  m22: "1",
};

/**
 * The field of one setting of a monitor.
 *
 * @param {object} app
 * @param {(string|number)[]} path the place of the monitor in the spec
 * @param {string} name
 */
export function settingField(app, path, name) {
  const { field, label, ...options } = SETTINGS[name];
  return field(app, label, [...path, name], options);
}

/** The kind of a monitor; one that names none is `fallback`. */
export const kindOf = (monitor, fallback = "auto") => monitor?.kind ?? fallback;

/**
 * The first u of a monitor, also inside an intersection; undefined where it has none.
 *
 * @param {object} monitor
 */
export function firstU(monitor) {
  return monitor?.u ?? (monitor?.monitors ?? []).map((member) => member.u).find((u) => u !== undefined);
}

/**
 * The monitor of another kind that keeps what both kinds have: u, functions and settings.
 *
 * @param {object} monitor
 * @param {string} kind
 * @param {string} unnamed the kind that needs no name
 */
export function asKind(monitor, kind, unnamed = "auto") {
  const { functions = [], common, more } = KINDS[kind];
  const u = firstU(monitor);
  const named = kind === unnamed ? {} : { kind };
  const kept = [...common, ...more].filter((name) => monitor[name] !== undefined);
  const settings = Object.fromEntries(kept.map((name) => [name, monitor[name]]));
  if (kind === "intersection") return { ...named, monitors: firstMembers(monitor, u), ...settings };
  const given = functions.map((name) => [name, monitor[name] ?? { expression: FIRST_FUNCTIONS[name] }]);
  return { ...named, ...Object.fromEntries(given), ...(u === undefined ? {} : { u }), ...settings };
}

// The monitor itself where it may be a member, and the arc length of the same u, or a weight where there is no u.
function firstMembers(monitor, u) {
  const second = u === undefined ? { kind: "weight", rho: { expression: FIRST_FUNCTIONS.rho } } : { u };
  if (!MEMBER_KINDS.includes(monitor.kind)) return [{ kind: "curvature", u }, second];
  const { orthogonality: _, ...first } = monitor;
  return [first, second];
}
