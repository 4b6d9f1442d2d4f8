// The Schwarz iteration, subdomain by subdomain, next to its convergence curve.

import { Curve, curveOf } from "../curve.js";
import { element } from "../dom.js";
import { mixed, outlineOf, stepsOf, turnsOf } from "../iterates.js";
import { createOutlines } from "../outlines.js";
import { createPlayer, wantsLittleMotion } from "../player.js";

// Subdomains that are shown each second.
const STEPS_PER_SECOND = 2;
// What a single domain is split into at a press of the button: a condition whose iteration can be watched.
const EXAMPLE = { subdomains: [2, 2], transmission: { kind: "classical" } };

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
    const split = element("button", { type: "button", onclick: () => this.split() }, "Split into 2 × 2 subdomains");
    this.none = element("div", {}, element("p", {}, "The mesh is computed on a single domain. There is no iteration to show."), split);
    this.shown = element("div", {}, this.player.element, this.status, this.curve.element, element("p", { class: "hint" },
      "The subdomains move one after another to their nodes in the next iterate, in the order in which they are solved. ",
      "Those of a parallel iteration are solved at the same time."));
    this.element = element("div", {}, this.none, this.shown);
  }

  split() {
    this.app.store.set(["spec", "schwarz"], EXAMPLE);
    this.app.announce("The domain is split into 2 × 2 subdomains.");
  }

  /** Leave the iteration of the spec before. */
  forget() {
    this.player.setSteps(0);
    this.player.pause();
    this.request?.abort();
    this.base = this.frames = this.steps = this.request = null;
    const hasSchwarz = Boolean(this.app.store.get().spec.schwarz);
    this.none.hidden = hasSchwarz;
    this.shown.hidden = !hasSchwarz;
    this.player.element.hidden = true;
    this.outlines.show([]);
    this.status.textContent = hasSchwarz ? "Waiting for the mesh." : "";
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
    this.tell(this.steps.length - 1);
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
