// A spec as a command of `equimesh generate`.

import { SETTINGS } from "../kinds.js";
import { hasBlocks } from "../sides.js";
import { FUNCTIONS, sourcesOf } from "../sources.js";
import { commonNames, isExpression, textOf } from "./functions.js";
import { command, quoted } from "./shell.js";

// Everything of a spec is quoted: a link may bring a spec of a stranger, whose command a visitor then pastes.

// Settings of a Schwarz iteration whose option has the same name.
const SCHWARZ = ["overlap", "ordering", "line_correction", "acceleration", "local_solver", "max_iterations", "local_steps", "max_exchanges"];
const MESH = ["boundary", "initial", "mode", "cells", "parts", "label"];

/**
 * Commands that request the mesh, and write its file; or a sentence that says what the command line has no option for.
 *
 * @param {object} spec
 * @param {{url: string, format: {suffix: string}, hasKey: boolean}} options
 * @returns {{text: string} | {missing: string}}
 */
export function commandOf(spec, { url, format, hasKey }) {
  const { monitor = {}, target } = spec;
  if (monitor.kind === "intersection") return { missing: "The command line has no intersections. Copy curl or Python." };
  const hasError = (target?.error ?? null) !== null;
  if (hasError && target.max_points !== undefined) return { missing: "The command line has no limit of points for a target. Copy curl or Python." };
  const samples = sampleFiles(spec, url, hasKey);
  if (!samples) return { missing: "The command line has no samples inside a spec. Copy curl or Python." };
  const names = commonNames(withoutSamples(spec));
  if (!names) return { missing: "On the command line a name has one value in all functions. Copy curl or Python." };
  const u = monitor.u;
  const isFormula = u !== undefined && isExpression(u);
  // A text that begins with "-" would be read as an option; after "--" it is not.
  const isLast = isFormula && textOf(u).trim().startsWith("-");
  const domain = domainOf(spec.domain);
  const lines = [
    `equimesh generate${isFormula && !isLast ? ` ${quoted(textOf(u))}` : ""}`,
    ...(u !== undefined && !isFormula ? [`--samples ${quoted(fileOf(u))}`] : []),
    namesOf(names),
    monitorOf(monitor),
    target ? targetOf(target) : hasBlocks(spec.domain) && !spec.grid?.points ? "" : gridOf(spec.grid),
    domain.option,
    schwarzOf(spec.schwarz),
    [...MESH.filter((name) => spec[name] !== undefined).map((name) => option(name, spec[name])), ...(spec.allow_relaxed === false ? ["--no-relax"] : [])].join(" "),
    `--url ${quoted(url.replace(/\/$/, ""))} -o ${quoted(`mesh${format.suffix}`)}`,
    ...(isLast ? [`-- ${quoted(textOf(u))}`] : []),
  ];
  return { text: [...samples, ...domain.before, command(lines.filter(Boolean))].join("\n") };
}

const dashed = (word) => String(word).replaceAll("_", "-");
const option = (name, value) => `--${dashed(name)}=${quoted(value)}`;

function namesOf({ parameters, t }) {
  const given = Object.entries(parameters).map(([name, value]) => `--parameter ${quoted(`${name}=${value}`)}`);
  return [...given, ...(t === undefined ? [] : [option("t", t)])].join(" ");
}

function monitorOf({ kind = "auto", ...settings }) {
  const words = kind === "auto" ? [] : [`--monitor ${quoted(dashed(kind))}`];
  for (const name of FUNCTIONS.filter((one) => one !== "u")) if (settings[name] !== undefined) words.push(option(name, isExpression(settings[name]) ? textOf(settings[name]) : fileOf(settings[name])));
  for (const { name, type, default: usual } of Object.values(SETTINGS)) {
    const value = settings[name];
    if (value === undefined || value === null || (type === "flag" && value === usual)) continue;
    if (type === "flag") words.push(`--${value ? "" : "no-"}${dashed(name)}`);
    else if (name.length === 1) words.push(`-${name} ${quoted(value)}`);
    else words.push(option(name, type === "word" ? dashed(value) : value));
  }
  return words.join(" ");
}

function gridOf({ n_xi = 64, n_eta = 64, points } = {}) {
  if (points) return `--points ${quoted(points)}`;
  return n_xi === n_eta ? `-n ${quoted(n_xi)}` : `--n-xi ${quoted(n_xi)} --n-eta ${quoted(n_eta)}`;
}

function targetOf({ error, norm, max_points }) {
  const wanted = (error ?? null) === null ? `--points ${quoted(max_points)}` : `--target-error ${quoted(error)}`;
  return `${wanted}${norm ? ` --target-norm ${quoted(norm)}` : ""}`;
}

// Four curves, and rings around another centre, go by a file.
function domainOf(domain) {
  if (!domain) return { option: "", before: [] };
  const { kind = "rectangle", x = [0, 1], y = [0, 1], radii = [1, 2], closed = false, periodic = null } = domain;
  const { angles = closed ? [0, 360] : [0, 90] } = domain;
  if (kind === "rectangle") return { option: `--domain ${quoted(`rectangle:${[...x, ...y, ...(periodic ? [periodic] : [])].join(",")}`)}`, before: [] };
  if (kind === "annulus_sector" && !domain.center?.some(Boolean)) return { option: `--domain ${quoted(`annulus:${[...radii, ...angles, ...(closed ? ["closed"] : [])].join(",")}`)}`, before: [] };
  return { option: "--domain @domain.json", before: [`printf '%s' ${quoted(JSON.stringify(domain))} > domain.json`] };
}

/** How many subdomains, or the grid lines at which they meet: each with a comma. */
function divided(part) {
  return Array.isArray(part) ? `${part.join(",")},` : part;
}

function schwarzOf(schwarz) {
  if (!schwarz) return "";
  const { kind, p, data } = schwarz.transmission ?? {};
  const [along, across] = schwarz.subdomains ?? [2, 1];
  const words = [`--subdomains ${quoted(`${divided(along)}x${divided(across)}`)}`];
  if (kind) words.push(option("transmission", kind));
  if (p !== undefined) words.push(option("p", p));
  if (data !== undefined) words.push(option("interface_data", data));
  for (const name of SCHWARZ) if (schwarz[name] !== undefined) words.push(option(name, schwarz[name]));
  if (schwarz.tolerance !== undefined) words.push(option("tolerance", schwarz.tolerance ?? "none"));
  if (schwarz.fallback === false) words.push("--no-fallback");
  if (schwarz.compare_single_domain) words.push("--compare");
  return words.join(" ");
}

// Samples at the service are files of the command line: commands that get them first; null for samples inside the spec.
function sampleFiles(spec, url, hasKey) {
  const others = sourcesOf(spec).map(({ source }) => source).filter((source) => !isExpression(source));
  if (others.some((source) => !source.samples)) return null;
  const key = hasKey ? ' -H "Authorization: Bearer $EQUIMESH_KEY"' : "";
  return [...new Set(others.map((source) => source.samples))].map(
    (id) => `curl -sS --fail-with-body${key} ${quoted(`${url}v1/samples/${id}?format=npz`)} -o ${quoted(fileOf({ samples: id }))}`,
  );
}

const fileOf = ({ samples }) => `samples-${samples.slice(0, 8)}.npz`;

function withoutSamples(spec) {
  const monitor = Object.fromEntries(Object.entries(spec.monitor).filter(([, value]) => !value?.samples));
  return { ...spec, monitor };
}
