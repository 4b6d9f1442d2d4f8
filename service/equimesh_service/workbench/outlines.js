// Lines over the mesh along its nodes, such as those around a subdomain.

import { element } from "./dom.js";
import { blended } from "./drawing/nodes.js";

/**
 * Closed lines over the mesh, which follow it in every frame and in every pane.
 *
 * @param {object} stage `app.canvas`
 * @returns {{show: (lines: number[][]) => void}} `show` takes the indices of the nodes of each line, and replaces those
 *   before
 */
export function createOutlines(stage) {
  const group = element("g", { class: "outlines" });
  stage.overlay.append(group);
  let lines = [];

  function draw() {
    if (!stage.mesh || (!lines.length && !group.childElementCount)) return;
    const polygons = stage.panes.flatMap(({ blend }, pane) => {
      const [x, y] = blended(stage.mesh, blend);
      const points = (line) => line.map((at) => stage.toPane([x[at], y[at]], pane).map((pixel) => pixel.toFixed(1)).join(",")).join(" ");
      return lines.flatMap((line) => ["halo", "outline"].map((name) => element("polygon", { points: points(line), class: name })));
    });
    group.replaceChildren(...polygons);
  }

  stage.on(draw);
  return {
    show(next) {
      lines = next;
      stage.redraw();
    },
  };
}
