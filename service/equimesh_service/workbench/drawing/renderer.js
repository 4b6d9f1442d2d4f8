// Draws a mesh on a canvas: with WebGL2 where the browser has it, else with the canvas in two dimensions.

import { createPlainRenderer } from "./plain.js";
import { createWebglRenderer } from "./webgl.js";

/**
 * A renderer of one canvas.
 *
 * `setNodes(mesh)` takes `{blocks, x, y, uniformX, uniformY}` of `meshOf`: coordinates block by block, in C order.
 * `setColours({table, places, uniformPlaces, isFlat})` takes 256 colours, and for each node its place from 0 to 1 on
 * them, in both meshes; with `isFlat` the place of the node (i, j) is that of the cell from there to (i + 1, j + 1).
 * `draw(panes, camera, style)` draws both meshes and all between: each pane is `{left, top, width, height, blend}` in
 * pixels of the page, `blend` is 0 for the uniform mesh and 1 for the adapted one, and `style` is
 * `{ratio, lines, ink, paper, isMoving}`: pixels of the canvas for each of the page, whether lines are drawn, their
 * colour, that of the background, and whether something moves.  While it does, cells may be joined to be drawn in time;
 * `draw` returns `{stride, triangles}`, with `stride` the number of cells of a side that were drawn as one.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {{isPlain?: boolean}} [options] `isPlain` does without WebGL2
 */
export function createRenderer(canvas, { isPlain = false } = {}) {
  if (!isPlain) {
    // The shader smooths the lines itself, at a fraction of the cost.  What is opaque hides what is below it, which is
    // not drawn then.
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    const gl = canvas.getContext("webgl2", options);
    if (gl) return createWebglRenderer(canvas, gl);
  }
  return createPlainRenderer(canvas, canvas.getContext("2d"));
}
