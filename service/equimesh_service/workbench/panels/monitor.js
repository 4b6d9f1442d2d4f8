// The panel of the monitor: what the mesh follows, and the settings of that.

import { choiceField, faultLine, follow, scoped } from "../bound.js";
import { usesOf } from "../capabilities.js";
import { element } from "../dom.js";
import { FIRST_FUNCTIONS, KINDS, MEMBER_KINDS, asKind, firstU, kindOf, settingField } from "../kinds.js";
import { sourceField } from "../source.js";
import { replaced } from "../store.js";

const PLACE = ["monitor"];
// The fewest and the most monitors of an intersection.
const FEWEST = 2;
const MOST = 8;
const LABELS = { rho: "Density rho(x, y)", m11: "m11(x, y)", m12: "m12(x, y)", m22: "m22(x, y)", u: "u(x, y)" };
const HELP = { rho: "Positive; cells are small where it is large.", u: "The function whose error is measured." };

/**
 * The panel of the monitor.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const uses = usesOf(app, "monitors");
  const monitor = () => app.store.at(["spec", "monitor"]);
  const change = (next) => app.store.update((state) => ({ spec: { ...state.spec, monitor: next } }));
  const kinds = choiceField(app, "Kind", [...PLACE, "kind"], {
    choices: Object.entries(KINDS).map(([name, { title }]) => [name, title]),
    fallback: "auto",
    uses,
    onchoose: (kind) => change(asKind(monitor(), kind)),
  });
  const settings = element("div");
  // Settings of another kind are faults that no field shows.
  section.append(kinds, faultLine(app, (pointer) => /^\/monitor(\/monitors(\/\d+)?)?$/.test(pointer)), settings);
  rebuilt(app, settings, () => kindOf(monitor()), (inner, kind) =>
    kind === "intersection" ? members(inner, uses) : plain(inner, PLACE, kind, uses));
}

// Fields of one kind are removed when another kind is chosen.
function rebuilt(app, box, key, build) {
  let inner = null;
  let shown;
  follow(app, PLACE, () => {
    if (key() === shown) return;
    shown = key();
    inner?.end();
    inner = scoped(app);
    box.replaceChildren(...build(inner.app, shown));
  });
}

// The functions and settings of a monitor that is no intersection.
function plain(app, path, kind) {
  const { functions = [], common, more } = KINDS[kind] ?? { common: [], more: [] };
  const sources = functions.map((name) => sourceField(app, LABELS[name] ?? `${name}(x, y)`, [...path, name], { help: HELP[name] }));
  // The field above the mesh is for rho here, so u has a field of its own.
  if (functions.length) sources.push(sourceField(app, "u(x, y), if you like", [...path, "u"], { help: HELP.u, optional: true }));
  const hint = kind === "nodal_solution" && element("p", { class: "hint" },
    "u is a file with x, y and values at the nodes of a mesh with the points of the grid.");
  return [hint || null, ...sources, ...fields(app, path, kind, common), folded(app, path, kind, more)].filter(Boolean);
}

function fields(app, path, kind, names) {
  return names.map((name) => settingField(app, path, kind, name));
}

function folded(app, path, kind, names) {
  if (!names.length) return null;
  return element("details", { class: "more" }, element("summary", {}, "More settings"), fields(app, path, kind, names));
}

// The members of an intersection, and what belongs to all of them.
function members(app) {
  const list = () => app.store.at(["spec", "monitor", "monitors"]) ?? [];
  const put = (monitors) => app.store.update((state) => ({ spec: replaced(state.spec, ["monitor", "monitors"], monitors) }));
  const box = element("div");
  const add = element("button", { type: "button", onclick: () => put([...list(), newMember(list())]) }, "Add a monitor");
  const key = () => list().map((member) => kindOf(member, "arc_length")).join();
  rebuilt(app, box, key, (inner) => {
    add.disabled = list().length >= MOST;
    return list().map((member, k) => memberBox(inner, member, k, list, put));
  });
  const hint = element("p", { class: "hint" }, "Cells are as small as each of these requires; the error is that of the first u.");
  return [hint, box, add, folded(app, PLACE, "intersection", KINDS.intersection.more)];
}

function memberBox(app, member, k, list, put) {
  const path = [...PLACE, "monitors", k];
  const kind = kindOf(member, "arc_length");
  const needsU = kind === "arc_length" || kind === "curvature";
  const kinds = choiceField(app, `Kind of monitor ${k + 1}`, [...path, "kind"], {
    choices: MEMBER_KINDS.map((name) => [name, KINDS[name].title]),
    fallback: "arc_length",
    onchoose: (chosen) => put(replaced(list(), [k], memberOf(list()[k], chosen, list()))),
  });
  const remove = element("button", {
    type: "button",
    disabled: list().length <= FEWEST,
    "aria-label": `Remove monitor ${k + 1}`,
    onclick: () => put(list().filter((_, other) => other !== k)),
  }, "Remove");
  const u = needsU || member.u !== undefined ? sourceField(app, LABELS.u, [...path, "u"], { help: HELP.u }) : null;
  const { functions = [], common, more } = KINDS[kind];
  const sources = functions.map((name) => sourceField(app, LABELS[name] ?? `${name}(x, y)`, [...path, name], { help: HELP[name] }));
  // A bound of the angles belongs to the whole mesh.
  const rest = [...common, ...more].filter((name) => name !== "orthogonality" && name !== "map");
  return element("fieldset", {}, element("legend", {}, `Monitor ${k + 1}`), kinds, u, sources, fields(app, path, kind, rest), remove);
}

// A member of another kind; where it needs a u and has none, it takes that of the others.
function memberOf(member, kind, others) {
  const { orthogonality: _, map: __, ...changed } = asKind({ ...member, u: firstU(member) ?? firstU({ monitors: others }) }, kind, "arc_length");
  return changed;
}

function newMember(others) {
  const u = firstU({ monitors: others });
  return u === undefined ? { kind: "weight", rho: { expression: FIRST_FUNCTIONS.rho } } : { kind: "curvature", u };
}
