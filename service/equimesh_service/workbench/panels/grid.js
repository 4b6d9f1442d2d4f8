// The panel of the grid: how many points, or which error, and how the mesh is solved and written.

import { choiceField, faultLine, flagField, follow, numberField, tidy, wordOrNumberField } from "../bound.js";
import { capabilitiesOf, usesOf } from "../capabilities.js";
import { element, field, select } from "../dom.js";
import { hasBlocks } from "../sides.js";

// Points a side that are offered as buttons.
const SIZES = [33, 65, 129, 257];
// The points a side of the service, where a spec says nothing.
const USUAL = 64;
// The requested error, as a share of that of the present mesh, where a target is chosen.
const SHARE = 0.5;
// The requested error where that of the present mesh is not known.
const FIRST_ERROR = 1e-3;

/**
 * The panel of the grid.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  let lastGrid;
  const change = (parts) => app.store.update((state) => ({ spec: tidy({ ...state.spec, ...parts }) }));
  const by = select([{ value: "points", text: "points" }, { value: "error", text: "the error it has" }], "points", (value) => {
    const { grid, target: _, ...rest } = app.store.get().spec;
    lastGrid = grid ?? lastGrid;
    if (value === "error") app.store.update({ spec: { ...rest, target: { error: halfOf(app) } } });
    else app.store.update({ spec: { ...rest, ...(lastGrid ? { grid: lastGrid } : {}) } });
  });
  const sizes = element("div", { class: "row", role: "group", "aria-label": "Points a side" },
    SIZES.map((n) => element("button", { type: "button", onclick: () => change({ grid: { n_xi: n, n_eta: n } }) }, `${n} × ${n}`)));
  const points = element("div", {},
    sizes,
    numberField(app, "Points along xi", ["grid", "n_xi"], { fallback: USUAL, min: 4, step: 1 }),
    numberField(app, "Points along eta", ["grid", "n_eta"], { fallback: USUAL, min: 4, step: 1 }));
  const target = element("div", {},
    numberField(app, "Interpolation error", ["target", "error"], { min: 0, help: "In the units of u. The service finds the grid that reaches it." }),
    choiceField(app, "Error", ["target", "norm"], { fallback: "l2", choices: [["l2", "of u (L2)"], ["h1", "of its gradient (H1)"]] }),
    numberField(app, "At most so many points", ["target", "max_points"], { optional: true, min: 25, step: 1, placeholder: "limit of the service" }));
  const given = field("Grid given by", by, { inline: true });
  const own = element("div", {},
    element("p", { class: "hint" }, "The blocks say how many cells there are, unless you give a number of points."),
    numberField(app, "Points for which they are chosen", ["grid", "points"], { optional: true, min: 25, step: 1, placeholder: "as they are" }));
  section.append(given, own, points, target,
    faultLine(app, (pointer) => ["/grid", "/target", ""].includes(pointer)), more(app));
  follow(app, [], (spec) => {
    const isTarget = Boolean(spec.target);
    by.value = isTarget ? "error" : "points";
    own.hidden = !hasBlocks(spec.domain);
    given.hidden = !own.hidden;
    points.hidden = isTarget || !own.hidden;
    target.hidden = !isTarget || !own.hidden;
    const { n_xi = USUAL, n_eta = USUAL } = spec.grid ?? {};
    [...sizes.children].forEach((button, k) => button.setAttribute("aria-pressed", String(n_xi === SIZES[k] && n_eta === SIZES[k])));
  });
}

// How the mesh is solved, and what its file holds.
function more(app) {
  const parts = element("div", { hidden: true },
    wordOrNumberField(app, "Parts of the cluster", ["parts"], {
      words: [["", "only where needed"], ["auto", "automatic"]],
      fallback: null,
      number: 2,
      min: 1,
      step: 1,
      help: "A large mesh is computed by several workers, some rows each.",
    }));
  capabilitiesOf(app).then(({ limits }) => (parts.hidden = !limits.max_cluster_points)).catch(() => {});
  return element("details", { class: "more" }, element("summary", {}, "Sides, exactness, cells"),
    choiceField(app, "Points on the sides", ["boundary"], {
      fallback: "trace",
      choices: [
        ["trace", "by the metric there (trace)"],
        ["equidistributed_1d", "by u along the side (the paper's)"],
        ["orthogonal", "lines meet the sides at right angles"],
      ],
    }),
    choiceField(app, "Solved to", ["mode"], {
      fallback: "discretization",
      choices: [["discretization", "the error of the grid"], ["tight", "rounding"]],
      uses: usesOf(app, "modes"),
    }),
    choiceField(app, "Initial mesh", ["initial"], {
      fallback: "nested",
      choices: [["nested", "from coarser grids"], ["uniform", "uniform (the paper's)"]],
    }),
    flagField(app, "Accept relaxed meshes", ["allow_relaxed"], {
      fallback: true,
      help: "Where no exact mesh is found, a valid approximation is a success.",
    }),
    choiceField(app, "Cells of the file", ["cells"], {
      fallback: "quad",
      choices: [["quad", "quadrilaterals"], ["triangle", "triangles"]],
    }),
    parts);
}

// A target that asks for a better mesh than the present one.
function halfOf(app) {
  const measured = app.drawing?.document.quality?.interpolation_error?.l2;
  return Number.isFinite(measured) && measured > 0 ? Number((SHARE * measured).toPrecision(2)) : FIRST_ERROR;
}
