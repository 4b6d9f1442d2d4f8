// The first look at a mesh: the page computes it itself, so that a key is answered also where the service is far or busy.

import { arcLength, comparison, compile, domainOf, leastError } from "./browser/kernel.js";

// Milliseconds of work until something is shown, and of each piece of work after it.
const FIRST = 12;
const PIECE = 10;
// Kinds that the kernel makes, and settings that its meshes do not follow.
const METHODS = { auto: leastError, least_error: leastError, arc_length: arcLength };
const OTHERS = ["orthogonality", "rectilinear", "smoothing", "boundary", "map", "purpose", "for", "degree"];
// Steps from the mesh before, where a parameter alone has changed.
const FOLLOWING = 8;

/**
 * The first look: `begin(state, shape, wait)` begins after so many milliseconds, and tells whether the page can make it;
 * `end()` ends it.  `show(drawing)` is called with drawings as the service has them, without its certificate.
 *
 * @param {(drawing: object, state: object) => void} show
 */
export function createLook(show) {
  let timer = 0;
  let last = null; // the last mesh, with what it is of

  function begin(state, shape, wait) {
    end();
    const asked = askedOf(state, shape);
    if (asked) timer = setTimeout(() => work(state, asked), wait);
    return asked !== null;
  }

  function end() {
    clearTimeout(timer);
  }

  function work(state, { u, domain, compare, shape, kind, method, settings }) {
    const isFollowing = last?.kind === kind;
    const anew = () => method(u, shape, domain, settings);
    let steps = isFollowing ? method(u, shape, domain, { ...settings, start: last.mesh, steps: FOLLOWING }) : anew();
    let isFresh = !isFollowing;
    let isFirst = true;

    function piece() {
      const until = performance.now() + (isFirst ? FIRST : PIECE);
      let found = null;
      do found = steps.next().value ?? found;
      while (!found?.isLast && performance.now() < until);
      if (isFirst || found.isLast) {
        const preview = compare(found);
        last = { kind, mesh: preview.mesh };
        show(drawingOf(preview, state.spec), state);
      }
      if (found.isLast && isFresh) return;
      if (found.isLast) [steps, isFresh] = [anew(), true]; // the mesh that a page has that begins here
      isFirst = false;
      timer = setTimeout(piece, 0);
    }
    piece();
  }

  return { begin, end };
}

// What the kernel is asked for a state; null where it cannot make such a mesh, or the service says what is wrong.
function askedOf({ spec, samples }, shape) {
  const { u, kind = "auto", norm = "l2", a, b, scaled, ...others } = spec.monitor ?? {};
  const expression = typeof u === "string" ? u : u?.expression;
  const method = Object.hasOwn(METHODS, kind) ? METHODS[kind] : null;
  if (!method || samples || typeof expression !== "string" || norm !== "l2" || spec.schwarz || spec.target) return null;
  if (OTHERS.some((name) => others[name] !== undefined)) return null;
  try {
    const { parameters = {}, t = 0 } = typeof u === "string" ? {} : u;
    const [formula, domain] = [compile(expression, { ...parameters, t }), domainOf(spec.domain)];
    const settings = Object.fromEntries(Object.entries({ a, b, scaled }).filter(([, value]) => value !== undefined));
    const compare = comparison(formula, domain, shape);
    return { u: formula, domain, compare, shape, method, settings, kind: JSON.stringify([expression, spec.domain, shape, kind]) };
  } catch {
    return null; // also a description without its parts: the service names what is missing
  }
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
