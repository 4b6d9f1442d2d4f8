// The state as the part of an address after "#", so that a link shows what was seen.

import { COLOURS } from "./drawing/colours.js";
import { MOST_MESHES } from "./film.js";
import { START } from "./store.js";

const SHORT_KINDS = new Set(["auto", "least_error", "arc_length", "curvature"]);
// Milliseconds between two changes of the address: browsers refuse to change it hundreds of times in a row.
const PAUSE = 250;
// Longer addresses are cut off by some programs; samples inside a spec would make them.
const LONGEST = 30000;

/**
 * The state that an address tells, or `START` where it tells nothing that can be read.
 *
 * Two forms are read: `#spec=<JSON>&view=<JSON>&sliders=<JSON>`, and the short one, `#u=tanh(30*(x-y))&n=49`, which may
 * have `monitor`, too.
 *
 * @param {string} hash such as `location.hash`
 */
export function stateOf(hash) {
  // In an expression "+" is a sum, not a space.
  const words = new URLSearchParams(hash.slice(1).replaceAll("+", "%2B"));
  const view = { ...START.view, ...known(object(words.get("view")) ?? {}) };
  const spec = object(words.get("spec"));
  if (spec) return { spec, view, samples: null, sliders: rangesOf(object(words.get("sliders")) ?? {}) };
  if (!words.has("u")) return { ...START, view };
  const monitor = { u: { expression: words.get("u") } };
  if (SHORT_KINDS.has(words.get("monitor"))) monitor.kind = words.get("monitor");
  const points = Number.parseInt(words.get("n") ?? "65", 10) || 65;
  return { spec: { monitor, grid: { n_xi: points, n_eta: points } }, view, samples: null, sliders: {} };
}

/**
 * The part of an address after and with "#" that tells this state; "" for that of a page without one.
 *
 * @param {object} state
 */
export function hashOf(state) {
  const words = [];
  const view = Object.fromEntries(Object.entries(state.view).filter(([name, value]) => START.view[name] !== value));
  if (state.spec !== START.spec) words.push(["spec", state.spec]);
  if (Object.keys(view).length) words.push(["view", view]);
  if (state.sliders !== START.sliders && Object.keys(state.sliders).length) words.push(["sliders", state.sliders]);
  const hash = words.map(([name, value]) => `${name}=${encoded(value)}`).join("&");
  return hash && hash.length < LONGEST ? `#${hash}` : "";
}

/**
 * Keep the address of the page equal to the state, without new entries in the history, and follow an address that the
 * visitor enters.
 *
 * @param {object} store
 */
export function followAddress(store) {
  let written = location.hash;
  let shown = location.hash; // the same as the browser has it, which may escape more
  let timer = 0;
  function write() {
    timer = 0;
    // The visitor has just entered another address, which the event below brings.
    if (location.hash !== shown) return;
    const hash = hashOf(store.get());
    if (hash === written) return;
    written = hash;
    history.replaceState(null, "", hash || location.pathname + location.search);
    shown = location.hash;
  }
  store.subscribe(() => {
    timer ||= setTimeout(write, PAUSE);
  });
  addEventListener("hashchange", () => {
    if (location.hash === shown) return;
    written = shown = location.hash;
    store.update(stateOf(location.hash));
  });
}

// The entries of a view that are of the type which the page uses; a link may bring anything.
function known(view) {
  const isRight = ([name, value]) => typeof value === typeof START.view[name] && (name !== "colour" || Object.hasOwn(COLOURS, value));
  return Object.fromEntries(Object.entries(view).filter(isRight));
}

// The ranges of sliders that have two ends, and not more meshes than a film may have.
function rangesOf(sliders) {
  const isRight = ({ min, max, count = 2 }) =>
    Number.isFinite(min) && Number.isFinite(max) && min < max && Number.isInteger(count) && count >= 2 && count <= MOST_MESHES;
  return Object.fromEntries(Object.entries(sliders).filter(([, range]) => isRight(range ?? {})));
}

function object(text) {
  if (!text) return null;
  try {
    const value = JSON.parse(text);
    return value && typeof value === "object" && !Array.isArray(value) ? value : null;
  } catch {
    return null;
  }
}

// As few escapes as an address allows, so that a link can be read.
function encoded(value) {
  return encodeURIComponent(JSON.stringify(value)).replaceAll(/%(7B|7D|22|3A|2C|5B|5D|28|29|2A|2F)/g, (code) =>
    code === "%22" ? code : decodeURIComponent(code),
  );
}
