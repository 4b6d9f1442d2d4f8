// What the mesh is worth, in words and in numbers, with every warning.

import { element } from "../dom.js";
import { amount, duration } from "../words.js";

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

  app.on("drawing", (drawing) => {
    const { document: facts, isQuick } = drawing;
    const [first, ...others] = facts.sentences ?? [];
    const quick = { tone: "note", text: "This is a quick look. The requested mesh comes after it." };
    headline.textContent = first?.text ?? "";
    headline.className = `headline ${first?.tone ?? ""}`;
    list.replaceChildren(
      ...[...(isQuick ? [quick] : []), ...others].map(({ tone, text }) => element("li", { class: tone }, text)),
    );
    const numbers = numbersOf(drawing);
    rows.replaceChildren(
      ...numbers.map(([name, value]) => element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, value))),
    );
    app.status(statusOf(drawing));
    if (!isQuick && first) app.announce(first.text);
  });
}

function numbersOf({ arrays, document: facts }) {
  const { quality = {}, certificate = {}, seconds = {} } = facts;
  const gain = certificate.interpolation_gain ?? {};
  const shape = arrays.x?.shape;
  return [
    certificate.status && ["status", certificate.status],
    shape && ["points", pointsOf(facts, shape)],
    facts.blocks && ["blocks", String(facts.blocks.length)],
    gain.l2 && ["gain of the error of u (L2)", amount(gain.l2)],
    gain.h1 && ["gain of the error of its gradient (H1)", amount(gain.h1)],
    quality?.q_eq && ["largest Q_eq, 1 is equidistributed", amount(quality.q_eq.max)],
    quality?.min_jacobian !== undefined && [facts.blocks ? "smallest Jacobian, over the mean area" : "smallest Jacobian, 1 is uniform", amount(quality.min_jacobian)],
    seconds?.solve !== undefined && ["solved in", duration(1000 * seconds.solve)],
  ].filter(Boolean);
}

// The points of a mesh: of a grid in both directions, of blocks in all.
function pointsOf({ blocks, points }, shape) {
  return blocks ? String(points) : `${shape[0]} × ${shape[1]}`;
}

function statusOf({ arrays, document: facts, isQuick, milliseconds }) {
  const shape = arrays.x?.shape;
  const what = isQuick ? "Quick look" : shape ? "Mesh" : "No mesh";
  const points = shape ? ` of ${pointsOf(facts, shape)} points` : "";
  return `${what}${points}, ${duration(milliseconds ?? 0)} after the change.`;
}
