// The state as the part of an address after "#", so that a link shows what was seen.

import { COLOURS } from "./browser/colours.js";
import { MOST_MESHES } from "./film.js";
import { sourcesOf } from "./sources.js";
import { START } from "./store.js";

const SHORT_KINDS = new Set(["auto", "least_error", "arc_length", "curvature"]);
// Milliseconds between two changes of the address: browsers refuse to change it hundreds of times in a row.
const PAUSE = 250;
// Milliseconds without a change of the spec after which the next one is an entry of the history.
const REST = 1500;
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
 * What cannot be read of an address, as a sentence; null where all of it can.
 *
 * @param {string} hash such as `location.hash`
 */
export function faultOf(hash) {
  const words = new URLSearchParams(hash.slice(1).replaceAll("+", "%2B"));
  const names = [...words.keys()];
  if (!names.length) return null;
  const damaged = ["spec", "view", "sliders"].find((name) => words.has(name) && !object(words.get(name)));
  if (damaged) return `The ${damaged} of this link is damaged: it is no JSON object.`;
  if (words.has("spec") || words.has("view") || words.get("u")) return null;
  return "This link says nothing that the page can read.";
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
  const sliders = slidersInUse(state);
  if (Object.keys(sliders).length) words.push(["sliders", sliders]);
  const hash = words.map(([name, value]) => `${name}=${encoded(value)}`).join("&");
  return hash && hash.length < LONGEST ? `#${hash}` : "";
}

// The ranges of parameters that the spec has, and of t.
function slidersInUse({ spec, sliders }) {
  const used = new Set(["t", ...sourcesOf(spec).flatMap(({ source }) => Object.keys(source?.parameters ?? {}))]);
  return Object.fromEntries(Object.entries(sliders).filter(([name]) => used.has(name)));
}

/**
 * Keep the address of the page equal to the state, and follow an address that the visitor enters or goes back to.
 *
 * The history gets an entry for each question: for the first change of the spec after a rest, and after `step()`.
 * Further keys, a slider that is dragged, and the view change the entry that is there.
 *
 * @param {object} store
 * @param {(hash: string) => void} onFollow called with an address that the visitor entered or went back to
 * @returns {{step: () => void}} `step` makes the next change an entry of its own
 */
export function followAddress(store, onFollow = () => {}) {
  let written = location.hash;
  let shown = location.hash; // the same as the browser has it, which may escape more
  let timer = 0;
  let changed = -Infinity; // when the spec was changed last
  let isNext = false; // whether the next change of the address is an entry
  let followed = null; // the spec of an address that was entered, which has an entry

  function write() {
    clearTimeout(timer);
    timer = 0;
    // The visitor has just entered another address, which the event below brings.
    if (location.hash !== shown) return;
    const hash = hashOf(store.get());
    if (hash === written) return;
    written = hash;
    history[isNext ? "pushState" : "replaceState"](null, "", hash || location.pathname + location.search);
    isNext = false;
    shown = location.hash;
  }

  store.subscribe((state, before) => {
    if (state.spec !== before.spec && state.spec !== followed) {
      isNext ||= performance.now() - changed > REST;
      changed = performance.now();
    }
    timer ||= setTimeout(write, PAUSE);
  });
  addEventListener("hashchange", () => {
    if (location.hash === shown) return;
    written = shown = location.hash;
    changed = -Infinity;
    isNext = false;
    const state = stateOf(location.hash);
    followed = state.spec;
    store.update(state);
    onFollow(location.hash);
  });
  return {
    step() {
      if (timer) write();
      isNext = true;
    },
  };
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
