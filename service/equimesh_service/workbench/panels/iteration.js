// The Schwarz iteration, subdomain by subdomain, next to its convergence curve.

import { Curve, curveOf } from "../curve.js";
import { element } from "../dom.js";
import { mixed, outlineOf, stepsOf, turnsOf } from "../iterates.js";
import { createOutlines } from "../outlines.js";
import { createPlayer, wantsLittleMotion } from "../player.js";
import { Race, classicalOf, exampleOf, hasRival } from "../race.js";
import { sentenceOf } from "../remedies.js";
import { amount } from "../words.js";

// Subdomains that are shown each second.
const STEPS_PER_SECOND = 2;
// Iterations of a race that are shown each second.
const ITERATIONS_PER_SECOND = 4;

/**
 * The panel of the iteration.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const panel = new IterationPanel(app);
  section.append(panel.element);
  app.on("drawing", (drawing) => panel.follow(drawing));
  app.on("problem", (problem) => panel.miss(problem));
  app.store.subscribe((state, before) => {
    if (state.spec !== before.spec || state.samples !== before.samples) panel.forget();
  });
  panel.forget();
}

class IterationPanel {
  constructor(app) {
    this.app = app;
    this.curve = new Curve();
    this.outlines = createOutlines(app.canvas);
    this.status = element("p", { role: "status", class: "iteration-status" });
    this.player = createPlayer({
      name: "iteration",
      stepsPerSecond: STEPS_PER_SECOND,
      describe: (step) => this.inWords(step),
      onMove: (position, isPlaying) => this.show(position, isPlaying),
      limit: () => (this.frames ? Infinity : 0),
    });
    this.racer = createPlayer({
      name: "race",
      stepsPerSecond: ITERATIONS_PER_SECOND,
      describe: (step) => `Iteration ${step}`,
      onMove: (position) => this.showRace(position),
    });
    this.racer.element.hidden = true;
    const split = element("button", { type: "button", class: "primary", onclick: () => this.split() }, "Show one on 2 × 2 subdomains");
    this.compare = element("button", { type: "button", onclick: () => this.race() }, "Play it next to the classical condition");
    this.order = element("p", { class: "hint" },
      "The subdomains move one after another to their nodes in the next iterate, in the order in which they are solved. ",
      "Those of a parallel iteration are solved at the same time.");
    this.none = element("div", {}, element("p", {}, "The mesh is computed on a single domain, or by a descent on the error. There is no iteration to show."), split,
      element("p", { class: "hint" }, "Takes 17 × 17 points from the uniform mesh, and plays the optimized condition next to the classical one."));
    this.shown = element("div", {}, this.player.element, this.racer.element, this.status, this.curve.element, this.compare, this.order);
    this.element = element("div", {}, this.none, this.shown);
  }

  split() {
    this.app.change({ spec: exampleOf(this.app.store.get().spec) });
    this.isRaceWanted = true; // as soon as its mesh is here
    this.app.announce("The domain is split into 2 × 2 subdomains.");
  }

  /** Fetch the iterates of both conditions, and play them. */
  async race() {
    const { spec, samples } = this.app.store.get();
    this.request?.abort();
    const mine = (this.request = new AbortController());
    const options = { samples: samples?.file ?? null, frames: true, isPatient: true, signal: mine.signal };
    this.status.textContent = "Both iterations are computed.";
    this.compare.disabled = true;
    try {
      const optimized = await this.app.service.preview(spec, options);
      const classical = await this.app.service.preview(classicalOf(spec), options);
      if (this.request === mine) this.startRace(optimized, classical);
    } catch (error) {
      if (error.name === "AbortError" || this.request !== mine) return;
      this.status.textContent = `The iterations cannot be shown. ${error.message}`;
      this.compare.disabled = false;
    } finally {
      if (this.request === mine) this.request = null;
    }
  }

  startRace(optimized, classical) {
    this.rivals = new Race(optimized, classical);
    this.ends = [classical, optimized].map(({ document }) => (document.error ? "not converged" : "converged"));
    this.player.pause();
    this.player.element.hidden = this.compare.hidden = this.order.hidden = true;
    this.racer.element.hidden = false;
    this.outlines.show([]);
    this.curve.draw(curveOf(optimized.document.convergence), curveOf(classical.document.convergence));
    this.app.store.update({ view: { layout: "pair", blend: 1 } });
    this.racer.setSteps(this.rivals.last, 0);
    this.racer.play();
  }

  showRace(position) {
    if (!this.rivals || !this.base) return;
    const { nodes: [classical, optimized], factor, done } = this.rivals.at(position);
    const { shape } = this.rivals;
    const words = (k) => (done[k] ? `, ${this.ends[k]}` : "");
    const ends = this.rivals.sides.map(({ numbers }) => numbers.at(-1));
    const text = done[0] ? `The optimized condition took ${ends[1]} iterations, the classical one ${ends[0]}.` : `Iteration ${Math.round(position)}`;
    const array = (data) => ({ data, shape });
    const arrays = { x: array(optimized[0]), y: array(optimized[1]), uniform_x: array(classical[0]), uniform_y: array(classical[1]) };
    this.app.show({
      ...this.base,
      document: { ...this.base.document, certificate: {}, quality: {}, sentences: [{ tone: done[0] ? "good" : "", text }] },
      arrays,
      captions: [["classical", words(0)], ["optimized", words(1)]],
      isIterate: true,
      like: this.base,
    });
    this.curve.mark(Math.min(Math.round(position), ends[1]));
    this.status.textContent = `Iteration ${Math.round(position)} of ${ends[0]}. The distance from the mesh that both go to is drawn ${amount(factor)} times larger.`;
  }

  /** Leave the iteration of the spec before. */
  forget() {
    for (const player of [this.player, this.racer]) {
      player.setSteps(0);
      player.pause();
      player.element.hidden = true;
    }
    this.request?.abort();
    this.base = this.frames = this.steps = this.request = this.rivals = null;
    const { spec } = this.app.store.get();
    const hasSchwarz = Boolean(spec.schwarz) && spec.monitor?.kind !== "least_error"; // a descent has no iterates
    this.compare.hidden = true;
    this.compare.disabled = this.order.hidden = false;
    this.none.hidden = hasSchwarz;
    this.shown.hidden = !hasSchwarz;
    this.outlines.show([]);
    this.status.textContent = hasSchwarz ? "Waiting for the mesh." : "";
  }

  /** There is no mesh, so that no iteration is waited for. */
  miss(problem) {
    if (problem && !this.base && this.app.store.get().spec.schwarz) this.status.textContent = sentenceOf(problem);
  }

  /** The iteration is that of the last drawing that is no iterate itself. */
  follow(drawing) {
    if (drawing.isIterate) return;
    this.forget();
    const { convergence, subdomains } = drawing.document;
    if (drawing.isQuick || !subdomains || !convergence?.iterations?.length) return;
    this.base = drawing;
    this.curve.draw(curveOf(convergence));
    this.takeSteps(convergence.iterations.map(({ iteration }) => iteration));
    this.player.element.hidden = false;
    this.compare.hidden = !hasRival(this.app.store.get().spec);
    this.tell(this.steps.length - 1);
    if (this.isRaceWanted) this.race();
    this.isRaceWanted = false;
  }

  // One step for each subdomain and each of these iterates; the position is the end.
  takeSteps(iterates) {
    const { subdomains, ordering } = this.base.document;
    this.iterates = iterates;
    this.steps = stepsOf(iterates.length - 1, turnsOf(subdomains, ordering), ordering === "parallel");
    this.player.setSteps(this.steps.length - 1, this.steps.length - 1);
  }

  /** Show a step; a position between two steps is on the way to the later one. */
  show(position, isPlaying) {
    if (!this.base) return;
    const number = Math.ceil(position);
    this.tell(number);
    if (!this.frames) {
      this.status.textContent = "The iterates are fetched.";
      this.fetchFrames();
      return;
    }
    const step = this.steps[number];
    if (number === this.steps.length - 1 && !isPlaying) {
      this.app.show({ ...this.base, isIterate: true });
      this.outlines.show([]);
      return;
    }
    const share = wantsLittleMotion() || position === number ? 1 : position - (number - 1);
    this.draw(step, share, this.inWords(number));
  }

  tell(number) {
    this.status.textContent = this.inWords(number);
    this.curve.mark(this.iterates[this.steps[number].iteration]);
  }

  inWords(number) {
    const step = this.steps?.[number];
    if (!step) return "";
    const last = this.iterates[this.iterates.length - 1];
    if (step.iteration === 0) return "The start of the iteration.";
    const names = step.active.map((one) => one + 1).join(", ");
    const which = step.active.length > 1 ? `subdomains ${names}` : `subdomain ${names}`;
    return `Iteration ${this.iterates[step.iteration]} of ${last}, ${which} of ${this.base.document.subdomains.length}.`;
  }

  draw(step, share, text) {
    const { subdomains } = this.base.document;
    const { frames_x: xs, frames_y: ys } = this.frames;
    const [, rows, columns] = xs.shape;
    const frame = (frames, k) => frames.data.subarray(k * rows * columns, (k + 1) * rows * columns);
    const before = Math.max(step.iteration - 1, 0);
    const of = (frames) => mixed(frame(frames, before), frame(frames, step.iteration), step, subdomains, columns, share);
    const [x, y] = [of(xs), of(ys)];
    const shape = [rows, columns];
    // Values at nodes and in cells, and what is said of the mesh, are those of the last mesh, so they are left out.
    this.app.show({
      ...this.base,
      document: { ...this.base.document, certificate: {}, quality: {}, sentences: [{ tone: "note", text }] },
      arrays: { ...kept(this.base.arrays), x: { data: x, shape }, y: { data: y, shape } },
      isIterate: true,
      like: this.base,
    });
    this.outlines.show(step.active.map((one) => outlineOf(subdomains[one], columns)));
  }

  async fetchFrames() {
    if (this.request) return;
    const mine = (this.request = new AbortController());
    const { spec, samples } = this.app.store.get();
    try {
      const options = { samples: samples?.file ?? null, frames: true, isPatient: true, signal: mine.signal };
      const found = await this.app.service.preview(spec, options);
      if (this.request !== mine) return;
      this.takeFrames(found);
    } catch (error) {
      if (error.name === "AbortError" || this.request !== mine) return;
      this.player.pause();
      this.status.textContent = `The iterates cannot be shown. ${error.message}`;
      this.request = null;
    }
  }

  takeFrames({ arrays, document }) {
    this.frames = arrays;
    const position = this.player.position;
    const isPlaying = this.player.isPlaying;
    const shown = document.frames ?? this.iterates;
    if (shown.length !== this.iterates.length) this.takeSteps(shown);
    this.player.setSteps(this.steps.length - 1, position);
    this.show(this.player.position, isPlaying);
  }
}

// What holds for every iterate.
function kept(arrays) {
  return Object.fromEntries(Object.entries(arrays).filter(([name]) => name.startsWith("uniform_") && !/_(u|q_eq|error)$/.test(name)));
}
