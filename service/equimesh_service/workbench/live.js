// From a change of the state to the next drawing: one request at a time, and answers in the order of the changes.

import { createLook } from "./first_look.js";
import { waitingOf } from "./notice.js";
import { hasBlocks } from "./sides.js";

// Kinds that compare candidates or descend: they take longer than one may wait while typing.
const SLOW_KINDS = new Set([undefined, "auto", "least_error"]);
// Kinds whose mesh does not follow u, even where they have one.
const LED_BY_OTHERS = new Set(["nodal_solution", "weight", "tensor"]);
// The fewest points of a side of any mesh, and the most of a quick look.
const FEWEST_POINTS = 4;
const QUICK_POINTS = 65;
// The most cells of a quick look at blocks, about: a descent on them takes some 50 ms.
const QUICK_CELLS = 1000;
// Cells along an edge that a description leaves to other edges, to estimate how many there are.
const USUAL_CELLS = 16;
// Meshes of more points get a quick look, whatever their kind.
const MOST_POINTS = 129 * 129;
// Averages the metric of a quick look, so that it nearly always converges at once; in units of the domain's extent.
const QUICK_SMOOTHING = 0.02;
// Milliseconds of an answer from which meshes of the same kind get a quick look, too.
const SLOW = 250;
// Milliseconds without a change until a slow mesh is requested: while typing, no work of the service is wasted.
const PAUSE = 220;
// Statuses of a service that does not answer, or whose workers start or are all busy, and milliseconds until the next
// attempt.
const GONE = 0;
const BUSY = new Set([GONE, 429, 503]);
const AGAIN = 700;
const AGAIN_GONE = 1500;
// Milliseconds after which a change ends the request before it, in place of waiting for its answer.
const PATIENCE = 150;

/**
 * Requests a preview after every change of the spec or the samples.
 *
 * While one answer is awaited, further changes wait, and only the last of them is requested next.  A request that takes
 * long is given up as soon as there is a change.  Meshes that are slow get a quick look first.
 *
 * @param {object} app with `store`, `service`, and `emit(name, value)`
 */
export function createLive(app) {
  const { store, service } = app;
  let wanted = null; // the change that is not requested yet
  let flight = null; // the request that is not answered yet
  let slowTimer = 0;
  let againTimer = 0;
  let isPaused = false;
  let answers = 0; // so that what an older answer says is not told after a newer one
  const slowKinds = new Set(); // those whose last answer took long
  const look = createLook(showLook);
  let looked = null; // the change that the page itself shows first
  let trouble = ""; // why the service does not answer now

  function showLook(drawing, state) {
    app.show({ ...drawing, milliseconds: performance.now() - looked.changed, state });
    if (trouble) app.status(trouble);
  }

  /** Whether the page itself shows a change that is newer than the request: an older mesh does not take its place. */
  function showsNewer() {
    return wanted !== null && Boolean(app.drawing?.isLocal) && app.drawing.state === wanted.state;
  }

  function forgetSlow() {
    clearTimeout(slowTimer);
    slowTimer = 0; // the page is busy while it is not 0
  }

  function change(state) {
    forgetSlow();
    clearTimeout(againTimer);
    app.emit("stale", true);
    wanted = { state, changed: performance.now() };
    look.end();
    looked = null;
    if (isPaused) return;
    const shape = lookShape(state.spec);
    if (shape && look.begin(state, shape)) looked = wanted;
    if (flight && (flight.isSlow || performance.now() - flight.began > PATIENCE)) flight.controller.abort();
    if (!flight || flight.controller.signal.aborted) next();
  }

  function next() {
    if (!wanted) return;
    const { state, changed } = wanted;
    const isLooked = wanted === looked;
    wanted = null;
    const quick = quickSpec(state.spec);
    if (!quick || !isSlowSpec(state.spec, slowKinds)) {
      fly(state, state.spec, { changed, isQuick: false });
      return;
    }
    if (isLooked) app.emit("busy", true);
    else fly(state, quick, { changed, isQuick: true });
    slowTimer = setTimeout(() => slow(state, changed), PAUSE);
  }

  // The requested mesh, after its quick look; a change in between has ended the timer.
  function slow(state, changed) {
    if (flight) slowTimer = setTimeout(() => slow(state, changed), 30);
    else if (!wanted) fly(state, state.spec, { changed, isQuick: false, isSlow: true });
  }

  /** What is wrong with a change, if anything; an answer to an older one may have been shown after it. */
  function tellProblem(problem, state) {
    if (app.drawing?.state !== state) app.emit("stale", true);
    app.emit("problem", problem);
  }

  async function fly(state, spec, { changed, isQuick, isSlow = false }) {
    const mine = { controller: new AbortController(), began: performance.now(), isSlow };
    flight = mine;
    app.emit("busy", true);
    const samples = state.samples?.file ?? null;
    try {
      const drawing = await service.preview(spec, { samples, signal: mine.controller.signal });
      if (flight !== mine) return;
      tellAnswered();
      if (!wanted) look.end();
      if (!isQuick) slowKinds[performance.now() - mine.began > SLOW ? "add" : "delete"](kindOf(spec));
      if (showsNewer()) return;
      if (hasMesh(drawing) || !app.drawing || app.drawing.isLocal) app.show({ ...drawing, isQuick, milliseconds: performance.now() - changed, state });
      tellProblem(drawing.document.error ?? null, state);
    } catch (error) {
      if (flight !== mine || error.name === "AbortError") return;
      if (BUSY.has(error.problem?.status)) {
        tellBusy(error);
        // A quick look is not tried again: it would come after the requested mesh, which follows anyway.
        if (isQuick || wanted) return;
        const pause = error.problem.status === GONE ? AGAIN_GONE : AGAIN;
        againTimer = setTimeout(() => !flight && !wanted && fly(state, spec, { changed, isQuick, isSlow }), pause);
        return;
      }
      tellAnswered();
      // The requested mesh will tell what is wrong with it; its quick look need not exist.
      if (!isQuick || isFaultOf(error)) {
        if (isQuick) forgetSlow();
        if (!wanted) look.end();
        tellProblem(error.problem ?? { title: "The page failed", detail: error.message }, state);
      }
    } finally {
      if (flight === mine) {
        flight = null;
        app.emit("busy", slowTimer !== 0 && isQuick);
        if (wanted && !isPaused) next();
      }
    }
  }

  async function tellBusy(error) {
    trouble = `${error.message} The page tries again.`;
    app.status(trouble);
    const told = (answers += 1);
    const readiness = error.problem.status === GONE ? null : await service.readiness();
    if (told === answers) app.notice("service", waitingOf(error.problem, readiness));
  }

  function tellAnswered() {
    answers += 1;
    trouble = "";
    app.notice("service", null);
  }

  store.subscribe((state, before) => {
    if (state.spec !== before.spec || state.samples !== before.samples) change(state);
  });

  return {
    /** Request the preview of the state as it is. */
    refresh: () => change(store.get()),
    /** While paused, changes request nothing; another panel shows its own drawings. */
    pause(value) {
      isPaused = value;
      look.end();
      if (!value && wanted) next();
    },
    /** How long the page waits before it requests a slow mesh, in milliseconds. */
    PAUSE,
  };
}

// A solve that failed may have no mesh, or one that is folded: then the uniform one alone is in the drawing.
function hasMesh({ arrays }) {
  return Boolean(arrays.x);
}

function isGrid({ n_xi: n = FEWEST_POINTS, n_eta: m = FEWEST_POINTS }) {
  return n >= FEWEST_POINTS && m >= FEWEST_POINTS;
}

function pointsOf({ n_xi: n = 64, n_eta: m = 64 } = {}) {
  return n * m;
}

function kindOf({ monitor, schwarz }) {
  return `${monitor?.kind} ${Boolean(schwarz)}`;
}

/** Whether a mesh is shown by its quick look first; `slowKinds` are those whose last answer took long. */
export function isSlowSpec(spec, slowKinds = new Set()) {
  const isLarge = pointsOf(spec.grid) > MOST_POINTS;
  return SLOW_KINDS.has(spec.monitor?.kind) || slowKinds.has(kindOf(spec)) || isLarge || Boolean(spec.target);
}

/** The points of the first look of the page itself; null where the service says what is wrong with the grid. */
export function lookShape({ grid = {}, domain }) {
  if (hasBlocks(domain) || !isGrid(grid)) return null;
  return fewerPoints(grid);
}

// At most so many points a side as a quick look has.
function fewerPoints({ n_xi: n = 64, n_eta: m = 64 }) {
  const shrink = Math.max(1, n / QUICK_POINTS, m / QUICK_POINTS);
  return [n, m].map((number) => Math.max(FEWEST_POINTS, Math.round(number / shrink)));
}

/**
 * The spec of a quick look at a mesh that takes long; null where u is not known, or the mesh is one itself.
 *
 * It is a smoothed arc-length mesh of at most 65 points a side: of all monitors the one that converges soonest.
 * Blocks take least error alone: one descent from their initial mesh, with fewer cells.
 *
 * @param {object} spec
 */
export function quickSpec(spec) {
  const { monitor = {}, grid = {}, domain, schwarz } = spec;
  if (!monitor.u || LED_BY_OTHERS.has(monitor.kind)) return null;
  if (hasBlocks(domain)) return quickBlocks(monitor, domain);
  if (!isGrid(grid)) return null; // the service says what is wrong with it
  if (monitor.kind === "arc_length" && !schwarz && pointsOf(grid) <= QUICK_POINTS ** 2) return null;
  const [n_xi, n_eta] = fewerPoints(grid);
  const quick = { monitor: { kind: "arc_length", u: monitor.u, smoothing: QUICK_SMOOTHING }, grid: { n_xi, n_eta } };
  return domain ? { ...quick, domain } : quick;
}

function quickBlocks({ kind, u, norm = "l2" }, domain) {
  const shrink = Math.min(1, Math.sqrt(QUICK_CELLS / cellsOf(domain)));
  if (kind === "least_error" && shrink === 1) return null;
  const fewer = shrink < 1 ? { ...domain, refine: (domain.refine ?? 1) * shrink } : domain;
  return { monitor: { kind: "least_error", u, norm }, domain: fewer };
}

// About how many cells a description of blocks has; 0 for the file of a mesh, whose cells only the service knows.
function cellsOf({ blocks, refine = 1 }) {
  const counted = (block) => [0, 1].reduce((product, k) => product * (block?.cells?.[k] ?? USUAL_CELLS), 1);
  return refine ** 2 * (Array.isArray(blocks) ? blocks : []).reduce((sum, block) => sum + counted(block), 0);
}

// Bad input is wrong for the requested mesh, too.
function isFaultOf(error) {
  return !error.problem || error.problem.status === 0 || (error.problem.errors ?? []).length > 0 || error.problem.status === 401;
}
