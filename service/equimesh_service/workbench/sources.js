// The functions of a spec: where they stand in it, and which of them depend on t.

import { CHOICES } from "./choices.js";

/** The keys of monitors that hold a function of x and y. */
export const FUNCTIONS = [...new Set(CHOICES.monitors.flatMap(({ functions }) => functions))];
// The name t in an expression, not as a part of a longer name.
const TIME = /(?<![\w.])t(?!\w)/;

/**
 * Every function of a spec with its place.
 *
 * @param {object} spec
 * @returns {{path: (string|number)[], source: any}[]} paths begin with "monitor"
 */
export function sourcesOf(spec) {
  const monitor = spec.monitor ?? {};
  const members = (Array.isArray(monitor.monitors) ? monitor.monitors : []).map((one, k) => [one, ["monitor", "monitors", k]]);
  return [[monitor, ["monitor"]], ...members].flatMap(([one, path]) =>
    FUNCTIONS.filter((name) => one?.[name] !== undefined).map((name) => ({ path: [...path, name], source: one[name] })),
  );
}

/** Whether a function of a spec is an expression that contains the time t. */
export function dependsOnTime(source) {
  const text = typeof source === "string" ? source : source?.expression;
  return typeof text === "string" && TIME.test(text);
}

/** The time of a spec: that of its first function with t; 0 where none says it, null where no function has t. */
export function timeOf(spec) {
  const found = sourcesOf(spec).find(({ source }) => dependsOnTime(source));
  return found ? (found.source.t ?? 0) : null;
}

/**
 * The same spec at another time: all functions with t get it.
 *
 * @param {object} spec
 * @param {number | null} t null removes the time
 */
export function atTime(spec, t) {
  const copy = structuredClone(spec);
  for (const { path, source } of sourcesOf(copy).filter((one) => dependsOnTime(one.source))) {
    const { t: _, ...rest } = typeof source === "string" ? { expression: source } : source;
    const owner = path.slice(0, -1).reduce((value, key) => value[key], copy);
    owner[path[path.length - 1]] = t === null ? rest : { ...rest, t };
  }
  return copy;
}
