// Next to the mesh: how many points it has, and what it follows.  The panels of the grid and the monitor have the rest.

import { choiceField, follow, numberField } from "../bound.js";
import { element } from "../dom.js";
import { KINDS, asKind } from "../kinds.js";
import { hasBlocks } from "../sides.js";

// The points a side of the service, where a spec says nothing.
const USUAL = 64;

/**
 * The row of the points and the monitor.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const side = (name, label) => {
    const box = numberField(app, label, ["grid", name], { fallback: USUAL, min: 4, step: 1 });
    box.querySelector("label").classList.add("hidden");
    return box;
  };
  const points = element("div", { class: "setup-points", role: "group", "aria-label": "Points" },
    element("span", { "aria-hidden": "true" }, "Points"), side("n_xi", "Points in xi"), element("span", { "aria-hidden": "true" }, "×"),
    side("n_eta", "Points in eta"));
  const monitor = choiceField(app, "Mesh follows", ["monitor", "kind"], {
    choices: Object.entries(KINDS).map(([name, { title }]) => [name, title]),
    fallback: "auto",
    onchoose: (kind) => app.change({ spec: { ...app.store.get().spec, monitor: asKind(app.store.at(["spec", "monitor"]), kind) } }),
  });
  monitor.querySelector("label").classList.add("hidden");
  const slot = element("p", { class: "setup-hint" });
  section.append(element("div", { class: "setup" }, points, monitor, slot));
  follow(app, [], (spec) => {
    const isByPoints = !hasBlocks(spec.domain) && !spec.target;
    points.hidden = !isByPoints;
    slot.textContent = hasBlocks(spec.domain) ? "The blocks say how many cells there are: see Domain." : spec.target ? "The points follow the requested error." : "";
  });
}
