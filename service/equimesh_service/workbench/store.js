// The state of the workbench: what is requested of the service, and how it is looked at.

/** The state of a page that was opened without an address of its own: the first problem of the README. */
export const START = Object.freeze({
  spec: {
    monitor: { u: { expression: "tanh(40*(y - 0.5 - 0.1*sin(2*pi*x)))" } },
    grid: { n_xi: 33, n_eta: 33 },
  },
  view: { colour: "error", blend: 1, lines: true, layout: "pair" },
  samples: null,
  sliders: {},
});

/**
 * A store of one state.  A state is never changed in place: a change makes a new one.
 *
 * `update(change)` takes a partial state, or a function of the state that returns one.  Its keys replace those of the
 * state; those of `view` are merged into the view.  `set(path, value)` changes one place, for instance
 * `set(["spec", "grid", "n_xi"], 33)`; `undefined` deletes the key.  `at(path)` reads one place.
 * Listeners of `subscribe(listener)` are called with (state, before) once a microtask, however many changes there were;
 * `subscribe` returns a function that ends it.
 *
 * @param {object} initial the first state
 */
export function createStore(initial) {
  let state = initial;
  let before = initial;
  let isScheduled = false;
  const listeners = new Set();

  function notify() {
    isScheduled = false;
    const old = before;
    before = state;
    for (const listener of [...listeners]) alone(() => listener(state, old));
  }

  function update(change) {
    const partial = typeof change === "function" ? change(state) : change;
    const view = partial.view ? { ...state.view, ...partial.view } : state.view;
    state = { ...state, ...partial, view };
    if (isScheduled) return;
    isScheduled = true;
    queueMicrotask(notify);
  }

  return {
    get: () => state,
    at: (path) => path.reduce((value, key) => value?.[key], state),
    update,
    set: (path, value) => update((now) => replaced(now, path, value)),
    subscribe(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
  };
}

/** Do a task of one panel: where it fails, as at the state of a damaged link, the others go on, and the console tells. */
export function alone(task) {
  try {
    task();
  } catch (error) {
    reportError(error);
  }
}

/** A copy of `value` with another value at the end of `path`; `undefined` there deletes the key. */
export function replaced(value, path, last) {
  if (path.length === 0) return last;
  const [key, ...rest] = path;
  const copy = Array.isArray(value) ? [...value] : { ...value };
  const inner = replaced(copy[key], rest, last);
  if (inner === undefined && !Array.isArray(copy)) delete copy[key];
  else copy[key] = inner;
  return copy;
}
