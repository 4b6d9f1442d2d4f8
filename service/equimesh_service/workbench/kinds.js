// The kinds of monitors with their settings, in the words of the page.

import { choiceField, flagField, numberField, sliderField } from "./bound.js";
import { CHOICES } from "./choices.js";

// The settings that most people change; the others of a kind are folded away.
const COMMON = new Set(["norm", "degree", "a", "b", "map", "curvature.smoothing"]);

/** The kinds: a title, the settings that most people change, the others, and the functions besides u. */
export const KINDS = Object.fromEntries(CHOICES.monitors.map(({ name: kind, title, functions, settings }) => {
  const isCommon = ({ name }) => COMMON.has(name) || COMMON.has(`${kind}.${name}`);
  const names = (chosen) => chosen.map(({ name }) => name);
  return [kind, {
    title,
    functions: functions.filter((name) => !["u", "adjoint", "earlier"].includes(name)),
    common: names(settings.filter(isCommon)),
    more: names(settings.filter((one) => !isCommon(one))),
  }];
}));

// The names of elements of each degree.
const ELEMENTS = ["bilinear", "biquadratic", "bicubic"];

// The settings of each kind, by their names, as the service describes them: those of one name may have other bounds.
const OF_KINDS = Object.fromEntries(CHOICES.monitors.map(({ name: kind, settings }) => [kind, byName(settings)]));

/** The settings of all monitors, by their names. */
export const SETTINGS = byName(CHOICES.monitors.flatMap(({ settings }) => settings));

function byName(settings) {
  return Object.fromEntries(settings.map((setting) => [setting.name, setting]));
}

/** The kinds that a member of an intersection can have. */
export const MEMBER_KINDS = CHOICES.monitors.filter(({ member }) => member).map(({ name }) => name);

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
 * @param {string} kind
 * @param {string} name
 */
export function settingField(app, path, kind, name) {
  const { type, title, default: fallback, help, words, minimum, maximum } = OF_KINDS[kind][name];
  const place = [...path, name];
  if (type === "flag") return flagField(app, title, place, { fallback, help });
  if (type === "word") return choiceField(app, title, place, { fallback, choices: words.map((word) => [word.name ?? "", word.title]) });
  if (name === "degree") {
    const wordsOf = (degree) => [degree, ELEMENTS[degree - 1]].filter(Boolean).join(": ");
    return sliderField(app, title, place, { fallback, help, wordsOf, min: minimum, max: maximum });
  }
  const bounds = Object.fromEntries(Object.entries({ min: minimum, max: maximum }).filter(([, bound]) => bound !== undefined));
  const optional = words.some((word) => word.name === null);
  return numberField(app, title, place, { fallback, help, optional, ...(optional ? { placeholder: "none" } : {}), ...bounds });
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
  const given = functions.map((name) => [name, monitor[name] ?? { expression: FIRST_FUNCTIONS[name] ?? "1" }]);
  return { ...named, ...Object.fromEntries(given), ...(u === undefined ? {} : { u }), ...settings };
}

// The monitor itself where it may be a member, and the arc length of the same u, or a weight where there is no u.
function firstMembers(monitor, u) {
  const second = u === undefined ? { kind: "weight", rho: { expression: FIRST_FUNCTIONS.rho } } : { u };
  if (!MEMBER_KINDS.includes(monitor.kind)) return [{ kind: "curvature", u }, second];
  const { orthogonality: _, ...first } = monitor;
  return [first, second];
}
