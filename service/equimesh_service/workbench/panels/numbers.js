// What the mesh is worth, in words and in numbers, with every warning.

import { element } from "../dom.js";
import { Density } from "../density.js";
import { amount, duration } from "../words.js";

// The headline of a quick look, and of a mesh that follows a drawing.
const QUICK = { tone: "", text: "A first look. The mesh with its numbers comes next." };
const LOCAL = { tone: "", text: "A first look that this page computes itself. The service's mesh with its numbers comes next." };
const DRAWN = { tone: "", text: "The mesh follows the density that you drew." };
// The order of sentences: what is wrong, what to know before one uses the mesh, and everything else.
const RANKS = ["bad", "warning", "good", "note", ""];
// The statuses of certificates in words.
const STATUSES = { completed: "all steps were taken", converged: "converged", relaxed: "a valid approximation", not_converged: "not converged" };

/**
 * The panel of the numbers.  The first sentence is also the headline over the figure.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const list = element("ul", { class: "sentences" });
  const rows = element("tbody", {});
  section.append(list, element("table", {}, element("caption", { class: "hidden" }, "Numbers of the mesh"), rows));
  const headline = document.getElementById("headline");

  app.on("problem", (problem) => {
    if (problem && !app.drawing) headline.textContent = "There is no mesh.";
    else if (problem && app.drawing.isQuick) headline.textContent = app.drawing.isLocal ? "A first look that this page computes itself." : "A first look with fewer points.";
  });
  app.on("drawing", (drawing) => {
    const [first, ...others] = sentencesOf(drawing);
    const { isQuick } = drawing;
    headline.textContent = first?.text ?? "";
    headline.className = `headline ${first?.tone ?? ""}`;
    const ranked = [...others].sort((one, other) => RANKS.indexOf(one.tone) - RANKS.indexOf(other.tone));
    list.replaceChildren(...ranked.map(({ tone, text }) => element("li", { class: tone }, text)));
    const numbers = numbersOf(drawing);
    rows.replaceChildren(
      ...numbers.map(([name, value]) => element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, value))),
    );
    app.status(statusOf(drawing));
    if (!isQuick && first) app.announce(first.text);
  });
}

/**
 * The sentences of a drawing, the headline first.
 *
 * A quick look has fewer points and another monitor, so its gain is not said.  A failed solve is told by its title, and
 * a density that was drawn by hand is not blamed for the error of u.
 *
 * @param {object} drawing
 * @returns {{tone: string, text: string}[]}
 */
export function sentencesOf({ document: facts, isQuick, isLocal, state }) {
  const [first, ...others] = facts.sentences ?? [];
  if (isQuick) return [isLocal ? LOCAL : QUICK, { tone: "note", text: "This is a quick look. The requested mesh comes after it." }];
  if (facts.error) return [{ tone: "bad", text: `${facts.error.title}.` }, ...(facts.sentences ?? [])];
  const rho = state?.spec.monitor?.rho ?? facts.spec?.monitor?.rho;
  if (Density.of(rho)) return [DRAWN, ...others];
  return first ? [first, ...others] : [];
}

function numbersOf({ arrays, document: facts, isQuick }) {
  const { quality = {}, certificate = {}, seconds = {} } = facts;
  const gain = (isQuick ? null : certificate.interpolation_gain) ?? {};
  const byDegree = (isQuick ? [] : certificate.gains_by_degree ?? []).filter((one) => one.l2);
  const solver = (isQuick ? null : certificate.solver_gain) ?? {};
  const shape = arrays.x?.shape;
  return [
    certificate.status && ["status", STATUSES[certificate.status] ?? certificate.status],
    shape && ["points", pointsOf(facts, shape)],
    facts.blocks && ["blocks", String(facts.blocks.length)],
    solver.l2 && ["gain of a solver's error (L2)", amount(solver.l2)],
    solver.h1 && ["gain of a solver's error of the gradient (H1)", amount(solver.h1)],
    gain.l2 && ["gain of interpolating u (L2)", amount(gain.l2)],
    gain.h1 && ["gain of its gradient (H1)", amount(gain.h1)],
    byDegree.length > 0 && [`gain for elements of degree ${byDegree.map((one) => one.degree).join(", ")} (L2)`, byDegree.map((one) => amount(one.l2)).join(", ")],
    quality?.q_eq && ["largest share of a cell (Q_eq), 1 is equal", amount(quality.q_eq.max)],
    quality?.min_jacobian !== undefined && [facts.blocks ? "smallest Jacobian, over the mean area" : "smallest Jacobian, 1 is uniform", amount(quality.min_jacobian)],
    seconds?.solve !== undefined && ["solved in", duration(1000 * seconds.solve)],
  ].filter(Boolean);
}

// The points of a mesh: of a grid in both directions, of blocks in all.
function pointsOf({ blocks, points }, shape) {
  return blocks ? String(points) : `${shape[0]} × ${shape[1]}`;
}

function statusOf({ arrays, document: facts, isQuick, isLocal, milliseconds }) {
  const shape = arrays.x?.shape;
  const what = isLocal ? "First look of the page" : isQuick ? "Quick look" : shape ? "Mesh" : "No mesh";
  const points = shape ? ` of ${pointsOf(facts, shape)} points` : "";
  return `${what}${points}, ${duration(milliseconds ?? 0)} after the change.`;
}
