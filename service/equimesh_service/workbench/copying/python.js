// A spec as a program in Python: for the client of a service, or for the solver alone.

import { CHOICES } from "../choices.js";
import { hasBlocks } from "../sides.js";
import { FUNCTIONS } from "../sources.js";
import { commonNames, textOf } from "./functions.js";

// Longer values are written over several lines.
const WIDTH = 88;
const INDENT = "    ";
const MONITORS = new Set(CHOICES.monitors.map(({ name }) => name));
const CONDITIONS = new Set(CHOICES.transmissions.map(({ name }) => name));
// Domains whose classes take the values of a spec.
const DOMAINS = ["annulus_sector", "rectangle"];
// A name that Python takes as it is.
const NAME = /^[A-Za-z_]\w*$/;
// Options of a mesh that have the same name and the same values in a spec.
const PLAIN = ["boundary", "mode", "initial", "allow_relaxed", "cells", "parts", "label"];

/**
 * A program that requests the mesh with the Python client, and writes its file.
 *
 * @param {object} spec
 * @param {{url: string, format: {suffix: string}, hasKey: boolean}} options
 */
export function clientProgram(spec, { url, format, hasKey }) {
  const imports = new Set(["Client"]);
  const values = callOf(spec, imports).map((line) => indented(line, 2));
  const key = hasKey ? ', key=os.environ["EQUIMESH_KEY"]' : "";
  return [
    ...(hasKey ? ["import os", ""] : []),
    `from equimesh_client import ${[...imports].sort().join(", ")}`,
    "",
    `with Client(${literal(url.replace(/\/$/, ""))}${key}) as client:`,
    `${INDENT}mesh = client.generate(`,
    ...values.map((line) => `${line},`),
    `${INDENT})`,
    `${INDENT}print(mesh.certificate)`,
    `${INDENT}mesh.download(${literal(`mesh${format.suffix}`)})`,
    "",
  ].join("\n");
}

/**
 * A program that solves for the mesh in its own process, without a service, and writes its file.
 *
 * @param {object} spec
 * @param {{format: {suffix: string}}} options
 */
export function solverProgram(spec, { format }) {
  return [
    "from equimesh import specs",
    "from equimesh.io import write_mesh",
    "",
    `spec = ${literal(spec, true)}`,
    "solution = specs.build(spec).solve()",
    "print(solution.certificate)",
    `write_mesh(${literal(`mesh${format.suffix}`)}, solution.data()${spec.cells ? `, cells=${literal(spec.cells)}` : ""})`,
    "",
  ].join("\n");
}

// The arguments of `generate`, one a line.
function callOf(spec, imports) {
  const { monitor = {}, grid = {}, domain, target, schwarz } = spec;
  const names = commonNames(spec);
  const isUsual = names && monitor.u !== undefined && !monitor.monitors;
  const lines = isUsual ? [literal(textOf(monitor.u))] : [];
  const aim = target ?? (grid?.points ? { max_points: grid.points } : null);
  if (aim) lines.push(`target=${call("Target", aim, imports)}`);
  else if (!hasBlocks(domain)) lines.push(`${isUsual ? "" : "n="}${pair([grid.n_xi ?? 64, grid.n_eta ?? 64])}`);
  if (names && Object.keys(names.parameters).length) lines.push(`parameters=${literal(names.parameters)}`);
  if (names?.t !== undefined) lines.push(`t=${literal(names.t)}`);
  const named = names ? monitorOf(monitor, isUsual, imports) : literal(monitor, true);
  if (named) lines.push(`monitor=${named}`);
  if (domain) lines.push(`domain=${domainOf(domain, imports)}`);
  if (schwarz) lines.push(`schwarz=${schwarzOf(schwarz, imports)}`);
  for (const name of PLAIN) if (spec[name] !== undefined) lines.push(`${name}=${literal(spec[name])}`);
  return lines;
}

// A monitor by its class; "" for the usual one.  Its u is an argument of `generate` where `withoutU`.
function monitorOf({ kind = "auto", monitors, ...settings }, withoutU, imports, unnamed = "auto") {
  if (!MONITORS.has(kind)) return literal({ kind, ...settings }, true);
  const { for: purpose, ...rest } = settings;
  if (withoutU) delete rest.u;
  for (const key of FUNCTIONS) if (rest[key] !== undefined) rest[key] = textOf(rest[key]);
  if (purpose) rest.purpose = purpose;
  if (kind === unnamed && unnamed === "auto" && !Object.keys(rest).length) return "";
  const name = classOf(kind);
  if (!monitors) return call(name, rest, imports);
  imports.add(name);
  const members = monitors.map((member) => monitorOf({ kind: "arc_length", ...member }, false, imports, null));
  return `${name}(${[`[${members.join(", ")}]`, ...argumentsOf(rest)].join(", ")})`;
}

// The class of a known kind: least_error is LeastError.
const classOf = (kind) => kind.split("_").map((word) => word[0].toUpperCase() + word.slice(1)).join("");

function domainOf({ kind = "rectangle", ...values }, imports) {
  return DOMAINS.includes(kind) ? call(classOf(kind), values, imports, (value) => (Array.isArray(value) ? pair(value) : literal(value))) : literal({ kind, ...values }, true);
}

function schwarzOf({ transmission, subdomains, ...settings }, imports) {
  const parts = subdomains ? [`subdomains=${pair(subdomains)}`] : [];
  if (transmission) {
    const { kind, p, ...values } = transmission;
    // A Robin condition takes its p first, and needs one.
    const isRobin = String(kind).endsWith("robin");
    if (!CONDITIONS.has(kind)) parts.push(`transmission=${literal(transmission)}`);
    else parts.push(`transmission=${call(classOf(kind), isRobin ? { p: p ?? "auto" } : values, imports)}`);
  }
  imports.add("Schwarz");
  return `Schwarz(${[...parts, ...argumentsOf(settings)].join(", ")})`;
}

function call(name, values, imports, write = literal) {
  imports.add(name);
  return `${name}(${argumentsOf(values, write).join(", ")})`;
}

// Arguments by their names.  A link may bring a key that is no name: as text it cannot become a part of the program.
function argumentsOf(values, write = literal) {
  return Object.entries(values).map(([key, value]) =>
    NAME.test(key) ? `${key}=${write(value)}` : `**{${literal(key)}: ${literal(value)}}`,
  );
}

const pair = ([first, second]) => `(${literal(first)}, ${literal(second)})`;

// The lines of a value that was written over several lines, moved to the right.
const indented = (text, depth) => text.split("\n").map((line) => INDENT.repeat(depth) + line).join("\n");

/**
 * A value of JSON as Python reads it: texts escaped as in JSON, which Python reads in the same way.
 *
 * @param {any} value
 * @param {boolean} [isSpread] over several lines, where it is long
 */
export function literal(value, isSpread = false) {
  if (value === null) return "None";
  if (value === true) return "True";
  if (value === false) return "False";
  if (typeof value !== "object") return JSON.stringify(value);
  const isList = Array.isArray(value);
  const entries = isList ? value.map((one) => literal(one)) : Object.entries(value).map(([key, one]) => `${JSON.stringify(key)}: ${literal(one)}`);
  const [open, close] = isList ? "[]" : "{}";
  const line = `${open}${entries.join(", ")}${close}`;
  if (!isSpread || isList || line.length <= WIDTH) return line;
  const lines = Object.entries(value).map(([key, one]) => `${JSON.stringify(key)}: ${literal(one, true)},`);
  return [open, ...lines.map((one) => indented(one, 1)), close].join("\n");
}
