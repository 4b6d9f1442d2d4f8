// The work on what a page asks: meshes in slices, so that a hand is never held up, each shown as soon as it is there.

import { arcLength, comparison, compile, domainOf, leastError } from "./kernel.js";

/** The methods, with their words. */
export const METHODS = { least_error: ["least error", leastError], arc_length: ["arc length", arcLength] };
// Milliseconds of work between two frames, and without a change until a mesh is computed anew from its beginning.
const SLICE = 12;
const PAUSE = 200;
// How many times as long as a drawing takes the work until the next one takes.
const DRAWING = 3;
// Steps that follow a slider from the mesh before.
const FOLLOWING = 8;

/**
 * Computes the meshes of a state, `{formula, parameters, domain, shape, method, settings}`; `settings` are the method's.
 *
 * `ask(state)` begins at the end of this task, so that the next frame shows a mesh, and ends what was asked before; it
 * tells whether the kernel can do it.  `end()` ends it.  `show(preview, isLast, isConverged)` is called with what
 * `comparison` gives, `fail(error)` where the kernel cannot make such a mesh.
 *
 * @param {{show: Function, fail: (error: Error) => void}} listeners
 */
export function createWork({ show, fail }) {
  let frame = 0;
  let timer = 0;
  let turn = 0; // how often what was asked before was ended
  let last = null; // the mesh shown, and what it is of

  function run(steps, compare, { isShown, settle }) {
    cancelAnimationFrame(frame);
    let cost = 0; // of the last drawing
    const slice = () => {
      const until = performance.now() + Math.max(SLICE, cost * DRAWING);
      let found;
      do found = steps.next().value;
      while (!found.isLast && performance.now() < until);
      const began = performance.now();
      if (isShown || found.isLast) settle(compare(found), found.isLast, found.isConverged);
      cost = performance.now() - began;
      if (!found.isLast) frame = requestAnimationFrame(slice);
    };
    slice();
  }

  function begin({ shape, method, domain, settings }, u, place, compare) {
    const kind = JSON.stringify([domain, shape, method]);
    const settle = (preview, isLast, isConverged) => {
      last = { kind, mesh: preview.mesh };
      show(preview, isLast, isConverged);
    };
    const [, steps] = METHODS[method];
    const isNew = last?.kind !== kind;
    const anew = () => run(steps(u, shape, place, settings), compare, { isShown: isNew, settle });
    if (isNew) {
      anew();
      return;
    }
    // The mesh before follows; the one that a reader gets who begins here comes when the hand rests.
    const following = steps(u, shape, place, { ...settings, start: last.mesh, steps: FOLLOWING });
    run(following, compare, { isShown: true, settle: (preview) => settle(preview, false) });
    timer = setTimeout(anew, PAUSE);
  }

  function end() {
    cancelAnimationFrame(frame);
    clearTimeout(timer);
    turn += 1;
  }

  function ask(state) {
    end();
    let work;
    try {
      const u = compile(state.formula, state.parameters);
      const place = domainOf(state.domain);
      work = [state, u, place, comparison(u, place, state.shape)];
    } catch (error) {
      fail(error);
      return false;
    }
    const mine = turn;
    queueMicrotask(() => mine === turn && begin(...work));
    return true;
  }

  return { ask, end };
}
