// The first look at a mesh: the page computes it itself, so that a key is answered also where the service is far or busy.

import { createWork } from "./browser/work.js";

// Kinds that the kernel makes, with its methods, and settings that its meshes do not follow.
const METHODS = { auto: "least_error", least_error: "least_error", arc_length: "arc_length" };
const OTHERS = ["orthogonality", "rectilinear", "smoothing", "boundary", "map", "purpose", "for", "degree"];

/**
 * The first look: `begin(state, shape)` begins, and tells whether the page can make it; `end()` ends it.  `show(drawing, state)`
 * is called with drawings as the service has them, without its certificate.
 *
 * @param {(drawing: object, state: object) => void} show
 */
export function createLook(show) {
  let now = null; // the state that is looked at
  // Also a description without its parts fails: the service names what is missing.
  const work = createWork({ show: (preview) => show(drawingOf(preview, now.spec), now), fail: () => {} });
  return {
    begin(state, shape) {
      work.end();
      now = state;
      const asked = askedOf(state, shape);
      return asked !== null && work.ask(asked);
    },
    end: work.end,
  };
}

// What the kernel is asked for a state; null where it does not make such meshes.
function askedOf({ spec, samples }, shape) {
  const { u, kind = "auto", norm = "l2", a, b, scaled, ...others } = spec.monitor ?? {};
  const { expression, parameters = {}, t = 0 } = typeof u === "string" ? { expression: u } : u ?? {};
  if (!Object.hasOwn(METHODS, kind) || samples || typeof expression !== "string" || norm !== "l2" || spec.schwarz || spec.target) return null;
  if (OTHERS.some((name) => others[name] !== undefined)) return null;
  const settings = Object.fromEntries(Object.entries({ a, b, scaled }).filter(([, value]) => value !== undefined));
  return { formula: expression, parameters: { ...parameters, t }, domain: spec.domain, shape, method: METHODS[kind], settings };
}

function drawingOf(preview, spec) {
  const { shape, l2, l2Uniform: uniform } = preview;
  const cells = shape.map((points) => points - 1);
  const at = (data, size) => ({ shape: size, data });
  const arrays = {
    x: at(preview.x, shape), y: at(preview.y, shape), u: at(preview.u, shape), error: at(preview.error, cells),
    uniform_x: at(preview.uniformX, shape), uniform_y: at(preview.uniformY, shape), uniform_u: at(preview.uniformU, shape),
    uniform_error: at(preview.uniformError, cells),
  };
  return { arrays, document: { spec, quality: { interpolation_error: { l2, l2_uniform: uniform } } }, isQuick: true, isLocal: true };
}
