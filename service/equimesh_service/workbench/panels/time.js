// A time for functions with t: the mesh follows while t plays.

import { element, field } from "../dom.js";
import { isSlowSpec, quickSpec } from "../live.js";
import { createPlayer } from "../player.js";
import { atTime, timeOf } from "../sources.js";
import { between, Film, MOST_MESHES } from "../film.js";

// Meshes that are shown each second.
const MESHES_PER_SECOND = 6;
// The range of t and the number of meshes in it, until they are changed.
const RANGE = { min: 0, max: 1, count: 25 };
// The fewest meshes of a film.
const FEWEST = 2;

/**
 * The panel of the time.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const panel = new TimePanel(app);
  section.append(panel.element);
  app.store.subscribe((state, before) => {
    if (state.spec !== before.spec || state.samples !== before.samples || state.sliders !== before.sliders) panel.follow();
  });
  panel.follow();
}

class TimePanel {
  constructor(app) {
    this.app = app;
    this.film = new Film(app);
    this.status = element("p", { role: "status", class: "time-status" });
    this.player = createPlayer({
      name: "time",
      stepsPerSecond: MESHES_PER_SECOND,
      describe: (step) => `t = ${words(this.at(step))}`,
      onMove: (position, isPlaying) => this.show(position, isPlaying),
      limit: () => this.film.ready - 1,
    });
    this.inputs = Object.fromEntries(
      Object.entries({ min: "from t", max: "to t", count: "meshes" }).map(([name, label]) => [name, this.numberInput(name, label)]),
    );
    this.none = element("p", {}, "Write t in the function, such as tanh(30*(x - t)), or choose Moving front in the gallery. Then a slider for t is here.");
    const fields = Object.values(this.inputs).map(({ row }) => row);
    this.shown = element("div", {}, this.player.element, this.status, element("div", { class: "row" }, fields), element("p", { class: "hint" },
      "Each mesh is a preview at its t; between two of them the nodes move on straight lines. While t plays, slow ",
      "monitors are shown by a quick look, and the requested mesh appears when it stops."));
    this.element = element("div", {}, this.none, this.shown);
  }

  numberInput(name, label) {
    const input = element("input", { type: "number", step: name === "count" ? "1" : "any", onchange: () => this.changeRange(name, input) });
    return { input, row: field(label, input) };
  }

  get range() {
    return { ...RANGE, ...this.app.store.get().sliders.t };
  }

  at(step) {
    const { min, max, count } = this.range;
    return min + ((max - min) * step) / (count - 1);
  }

  changeRange(name, input) {
    const range = { ...this.range, [name]: input.valueAsNumber };
    const isRight = Number.isFinite(range[name]) && range.min < range.max && range.count >= FEWEST && range.count <= MOST_MESHES;
    input.toggleAttribute("aria-invalid", false);
    if (!isRight || !Number.isInteger(range.count)) {
      input.setAttribute("aria-invalid", "true");
      this.say(`t runs from a smaller to a larger number, in ${FEWEST} to ${MOST_MESHES} meshes.`);
      return;
    }
    this.app.store.update((state) => ({ sliders: { ...state.sliders, t: range } }));
  }

  /** The spec has changed, or the range. */
  follow() {
    const { spec, samples } = this.app.store.get();
    const t = timeOf(spec);
    this.none.hidden = t !== null;
    this.shown.hidden = t === null;
    if (t === null) {
      this.player.pause();
      this.film.forget();
      return;
    }
    for (const [name, { input }] of Object.entries(this.inputs)) input.value = String(this.range[name]);
    const { min, max, count } = this.range;
    const timeless = atTime(spec, null);
    const quick = isSlowSpec(timeless) ? quickSpec(timeless) : null;
    const times = Array.from({ length: count }, (_, k) => this.at(k));
    const isSame = this.film.take(quick ?? timeless, samples, times, quick !== null);
    if (isSame && this.player.isPlaying) return;
    if (!isSame) this.player.pause();
    this.player.setSteps(count - 1, Math.round(((t - min) / (max - min)) * (count - 1)));
    this.say(`t = ${words(t)}`);
  }

  show(position, isPlaying) {
    const t = this.at(Math.round(position));
    if (isPlaying) this.film.fetch((error) => this.fail(error));
    const [before, after] = [Math.floor(position), Math.ceil(position)].map((k) => this.film.drawings[k]);
    if (before && after) this.app.show(between(before, after, position - Math.floor(position)));
    const isWaiting = isPlaying && position >= this.film.ready - 1 && this.film.ready < this.range.count;
    this.say(`t = ${words(this.at(position))}${isWaiting ? `, ${this.film.ready} of ${this.range.count} meshes are here` : ""}`);
    // Every move of the slider changes the spec; so does the end of playing.
    if (!isPlaying && timeOf(this.app.store.get().spec) !== t) {
      this.app.announce(`t = ${words(t)}`);
      this.app.store.update((state) => ({ spec: atTime(state.spec, t) }));
    }
  }

  fail(error) {
    this.player.pause();
    this.say(`The meshes cannot be shown. ${error.message}`);
  }

  say(text) {
    this.status.textContent = text;
  }
}

function words(t) {
  return String(Number(t.toPrecision(4)));
}
