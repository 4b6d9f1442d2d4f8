// The panel of the domain: a rectangle, a part of a ring, four curves or blocks, with a drawing of the sides.

import { choiceField, faultLine, flagField, follow, pairFields, pointerOf, tidy, write } from "../bound.js";
import { usesOf } from "../capabilities.js";
import { element, field, freshId, select } from "../dom.js";
import { freeNames } from "./function.js";
import { offerToFit } from "../fit.js";
import { createOutline } from "../outline.js";
import { SIDES, curvesOf, hasBlocks, pointsOf } from "../sides.js";
import { replaced } from "../store.js";
import { FIRST, descriptionForm, meshForm } from "./blocks.js";

const KINDS = [["rectangle", "Rectangle"], ["annulus_sector", "Part of a ring"], ["quadrilateral", "Four curves"], ["blocks", "Blocks"], ["fixed_rectangle", "Rectangle with fixed nodes"], ["mesh", "A mesh file"]];
// The monitors that blocks take.
const OF_BLOCKS = ["auto", "least_error"];
// What goes with a grid alone.
const OF_GRID = ["grid", "target", "boundary", "schwarz", "parts"];
// Points of a formula that becomes a list of points.
const SAMPLED = 9;
// Which end of which other side is at a corner: [side, whether it is the last point].
const CORNERS = {
  "bottom-first": ["left", false],
  "bottom-last": ["right", false],
  "right-first": ["bottom", true],
  "right-last": ["top", true],
  "top-first": ["left", true],
  "top-last": ["right", true],
  "left-first": ["bottom", false],
  "left-last": ["top", false],
};

/**
 * The panel of the domain.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const domain = () => app.store.at(["spec", "domain"]) ?? {};
  const put = (next) => app.store.update((state) => ({ spec: tidy({ ...(hasBlocks(next) ? withoutGrid(state.spec) : state.spec), domain: next }) }));
  const kinds = choiceField(app, "Kind", ["domain", "kind"], {
    choices: KINDS,
    fallback: "rectangle",
    uses: usesOf(app, "domains"),
    onchoose: (kind) => {
      const before = domain();
      put(asKind(before, kind));
      offerToFit(app, before);
    },
  });
  const outline = createOutline((side, k, point) => put(moved(domain(), side, k, point)));
  const forms = {
    rectangle: element("div", {}, pairFields(app, ["x from", "to"], ["domain", "x"], [0, 1]), pairFields(app, ["y from", "to"], ["domain", "y"], [0, 1]),
      choiceField(app, "Repeats itself", ["domain", "periodic"], {
        choices: [["", "nowhere"], ["x", "along x"], ["y", "along y"], ["both", "both ways"]],
        fallback: null,
        help: "Opposite sides are then one line, and mesh lines go on across it. u must repeat itself, too.",
      })),
    annulus_sector: element("div", {},
      pairFields(app, ["inner radius", "outer radius"], ["domain", "radii"], [1, 2], { min: 0 }),
      pairFields(app, ["first angle (degrees)", "last angle"], ["domain", "angles"], [0, 90]),
      flagField(app, "Closed: mesh lines run around the ring", ["domain", "closed"], { help: "For angles that are 360 degrees apart. The first and the last angle are then one line." }),
      element("details", { class: "more" }, element("summary", {}, "Centre"), pairFields(app, ["centre x", "centre y"], ["domain", "center"], [0, 0]))),
    quadrilateral: element("div", {},
      element("p", { class: "hint" }, "Bottom and top run from left to right, left and right from bottom to top. They meet at the corners. Points can be dragged, or moved with arrow keys."),
      flagField(app, "Closed: mesh lines run around", ["domain", "closed"], { help: "For an O-grid. Left and right are then one curve, or bottom and top, and mesh lines go on across it." }),
      SIDES.map((side) => curveForm(app, side, put))),
    blocks: descriptionForm(app, put, "blocks"),
    fixed_rectangle: descriptionForm(app, put, "fixed_rectangle"),
    mesh: meshForm(app, put),
  };
  section.append(kinds, outline.element, faultLine(app, (pointer) => /^\/domain(\/\w+)?$/.test(pointer) || (hasBlocks(domain()) && pointer.startsWith("/domain/"))), ...Object.values(forms));
  follow(app, ["domain"], (value) => {
    const kind = value?.kind ?? "rectangle";
    for (const [name, form] of Object.entries(forms)) form.hidden = name !== kind;
    outline.show(value);
  });
}

// The same place as another kind: four curves are those of the sides, other kinds begin with their defaults.
function asKind(domain, kind) {
  if (kind === "rectangle") return {};
  if (kind === "annulus_sector" || kind === "mesh") return { kind };
  if (FIRST[kind]) return { kind, ...FIRST[kind] };
  const curves = curvesOf(domain);
  return { kind, ...Object.fromEntries(SIDES.map((side) => [side, curves[side]])) };
}

// A spec without what goes with a grid; kinds of monitors that need grid lines give way to the automatic one.
function withoutGrid(spec) {
  const kept = Object.fromEntries(Object.entries(spec).filter(([name]) => !OF_GRID.includes(name)));
  const { u, kind } = spec.monitor ?? {};
  return u && !OF_BLOCKS.includes(kind ?? "auto") ? { ...kept, monitor: { u } } : kept;
}

// A corner belongs to two sides, and moves both where both are points.
function moved(domain, side, k, point) {
  let next = replaced(domain, [side, "points", k], point);
  const last = domain[side].points.length - 1;
  const ends = [k === 0 && "first", k === last && "last"].filter(Boolean);
  for (const end of ends) {
    const [other, isLast] = CORNERS[`${side}-${end}`];
    const points = domain[other]?.points;
    if (points) next = replaced(next, [other, "points", isLast ? points.length - 1 : 0], point);
  }
  return next;
}

// Fields of one side, which is two formulas or a list of points.
function curveForm(app, side, put) {
  const path = ["domain", side];
  const curve = () => app.store.at(["spec", ...path]);
  const change = (next) => put({ ...app.store.at(["spec", "domain"]), [side]: next });
  const kind = select([{ value: "points", text: "points" }, { value: "formulas", text: "formulas in t" }], "points", (value) => {
    if (!curve()) return;
    change(value === "points" ? asPoints(curve()) : asFormulas(curve()));
  });
  const kindBox = field(`${side} is given by`, kind, { inline: true });
  const formulas = element("div", {}, formulaField(app, [...path, "x"], `x(t) of ${side}`, change, curve), formulaField(app, [...path, "y"], `y(t) of ${side}`, change, curve), parameterFields(app, path));
  const points = pointsField(app, path, side);
  follow(app, path, (value) => {
    const hasPoints = Boolean(value?.points);
    kind.value = hasPoints ? "points" : "formulas";
    points.hidden = !hasPoints;
    formulas.hidden = hasPoints;
  });
  return element("fieldset", {}, element("legend", {}, side), kindBox, points, formulas);
}

function asPoints(curve) {
  if (curve.points) return curve;
  const points = pointsOf(curve);
  const picked = Array.from({ length: SAMPLED }, (_, k) => points[Math.round((k / (SAMPLED - 1)) * (points.length - 1))]);
  return { points: points.length ? picked.map((point) => point.map((value) => Number(value.toPrecision(6)))) : [[0, 0], [1, 0]] };
}

// The straight line between the ends.
function asFormulas({ points = [[0, 0], [1, 0]] }) {
  const [first, last] = [points[0], points[points.length - 1]];
  const [x, y] = [0, 1].map((axis) => (first[axis] === last[axis] ? `${first[axis]}` : `${first[axis]} + ${last[axis] - first[axis]}*t`));
  return { x, y };
}

function formulaField(app, path, label, change, curve) {
  const axis = path[path.length - 1];
  const input = element("input", { type: "text", class: "code", spellcheck: "false", autocomplete: "off", autocapitalize: "off" });
  input.addEventListener("input", () => {
    const { parameters = {}, ...next } = { ...curve(), [axis]: input.value };
    const names = freeNames(`${next.x} + ${next.y}`).filter((name) => name !== "t");
    const values = Object.fromEntries(names.map((name) => [name, parameters[name] ?? 1]));
    change(names.length ? { ...next, parameters: values } : next);
  });
  follow(app, path, (value) => {
    if (input.value !== (value ?? "")) input.value = value ?? "";
  });
  return field(label, input, { app, pointer: pointerOf(path) });
}

// Numbers for the further names in the formulas of a side.
function parameterFields(app, path) {
  const box = element("div", { class: "names" });
  follow(app, [...path, "parameters"], (values = {}) => {
    const names = Object.keys(values);
    if ([...box.querySelectorAll("input")].map((input) => input.dataset.name).join() !== names.join()) {
      box.replaceChildren(...names.map((name) => {
        const input = element("input", { type: "number", step: "any", "data-name": name });
        input.addEventListener("input", () => Number.isFinite(input.valueAsNumber) && write(app, [...path, "parameters", name], input.valueAsNumber));
        return field(name, input, { inline: true });
      }));
    }
    for (const input of box.querySelectorAll("input")) {
      if (document.activeElement !== input) input.value = values[input.dataset.name];
    }
  });
  return box;
}

// One point a line, as "x, y".
function pointsField(app, path, side) {
  const input = element("textarea", { rows: 3, class: "code", spellcheck: "false", id: freshId("points") });
  const box = field(`Points of ${side}, one "x, y" a line`, input, { app, pointer: pointerOf([...path, "points"]) });
  input.addEventListener("input", () => {
    const points = readPoints(input.value);
    box.querySelector(".fault").textContent = points ? "" : "Each line is two numbers, such as 0.5, 1.";
    if (points) write(app, [...path, "points"], points);
  });
  follow(app, [...path, "points"], (points) => {
    if (!points || JSON.stringify(readPoints(input.value)) === JSON.stringify(points)) return;
    input.value = points.map((point) => point.join(", ")).join("\n");
    input.rows = Math.min(12, Math.max(2, points.length));
  });
  return box;
}

function readPoints(text) {
  const points = text.trim().split("\n").filter((line) => line.trim()).map((line) => line.trim().split(/[\s,;]+/).map(Number));
  return points.length && points.every((point) => point.length === 2 && point.every(Number.isFinite)) ? points : null;
}
