// The functions of a spec, as far as programs take values of names for all of them at once.

import { dependsOnTime, sourcesOf } from "../sources.js";

/**
 * The values of names and the time that hold for every expression of a spec; null where two expressions differ in one,
 * or where an expression has a form that only JSON has.
 *
 * @param {object} spec
 * @returns {{parameters: Object<string, number>, t: number|undefined} | null}
 */
export function commonNames(spec) {
  const parameters = {};
  const times = new Set();
  for (const { source } of sourcesOf(spec)) {
    if (!isExpression(source)) return null;
    for (const [name, value] of Object.entries(source.parameters ?? {})) {
      if (name in parameters && parameters[name] !== value) return null;
      parameters[name] = value;
    }
    if (dependsOnTime(source)) times.add(source.t ?? 0);
  }
  if (times.size > 1) return null;
  const [t] = times;
  return { parameters, t: t || undefined };
}

/** Whether a function is an expression, and no samples. */
export function isExpression(source) {
  return typeof source === "string" || source?.expression !== undefined;
}

/** The text of an expression. */
export const textOf = (source) => (typeof source === "string" ? source : source.expression);
