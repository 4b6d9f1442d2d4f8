// A density that is drawn by hand. It becomes a weight monitor, with the density as samples.

import { Density } from "../density.js";
import { element, field, freshId } from "../dom.js";
import { START } from "../store.js";
import { Surface } from "../surface.js";

// The radius of the brush, as a share of the box of the domain: first, least, most.
const RADIUS = { value: 0.08, min: 0.03, max: 0.3, step: 0.01 };
// The density that a dab adds in its middle.
const STRENGTH = { value: 4, min: 0.5, max: 20, step: 0.5 };

/**
 * The panel to draw a density.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const panel = new SketchPanel(app);
  section.append(panel.element);
  app.on("drawing", () => panel.surface.redraw());
  app.store.subscribe((state, before) => {
    if (state.spec !== before.spec) panel.follow(state.spec, before.spec);
  });
}

class SketchPanel {
  constructor(app) {
    Object.assign(this, { app, density: new Density(), before: null, box: null, sent: null, isScheduled: false });
    this.radius = slider(RADIUS, () => this.show());
    this.strength = slider(STRENGTH, () => this.show());
    this.erase = element("button", { type: "button", "aria-pressed": "false", onclick: () => this.toggleErasing() }, "Erase");
    this.undo = element("button", { type: "button", onclick: () => this.takeBack() }, "Undo");
    this.clear = element("button", { type: "button", onclick: () => this.wipe() }, "Clear");
    this.toggle = element("button", { type: "button", "aria-pressed": "false", onclick: () => this.switch() }, "Draw on the mesh");
    this.leave = element("button", { type: "button", onclick: () => this.restore() }, "Back to the function");
    const help = element("p", { class: "hint", id: freshId("sketch-help") },
      "Draw on the mesh with mouse, finger or pen: cells become small where you draw. With the keyboard: arrows move the ",
      "brush (with Shift by less), Space draws, E switches the eraser, Z takes a stroke back, Escape ends drawing.");
    this.surface = new Surface(app.canvas, {
      onBegin: () => this.density.beginStroke(),
      onDab: (place) => this.dab(place),
      onEnd: () => this.send(),
      onUndo: () => this.takeBack(),
      describedby: help.id,
    });
    this.surface.canvas.addEventListener("keydown", (event) => this.press(event));
    this.element = element("div", { class: "sketch" }, element("div", { class: "row" }, this.toggle, this.erase, this.undo, this.clear, this.leave),
      field("Size of the brush", this.radius), field("Strength", this.strength), help);
    this.show();
  }

  get brush() {
    return { radius: this.radius.valueAsNumber, strength: this.strength.valueAsNumber, isErasing: this.erase.getAttribute("aria-pressed") === "true" };
  }

  /** Begin or end drawing. */
  async switch() {
    if (this.surface.isOpen) {
      this.finish();
      return;
    }
    await this.takeBox(this.app.store.get().spec.domain);
    this.toggle.setAttribute("aria-pressed", "true");
    this.surface.open(this.box);
    this.show();
    this.app.announce("Drawing has begun. Arrows move the brush, Space draws.");
  }

  finish() {
    this.surface.close();
    this.toggle.setAttribute("aria-pressed", "false");
    this.app.announce("Drawing has ended.");
  }

  press(event) {
    if (event.key === "Escape") {
      this.finish();
      this.toggle.focus();
    } else if (event.key.toLowerCase() === "e") {
      this.toggleErasing();
    } else {
      return;
    }
    event.preventDefault();
  }

  toggleErasing() {
    this.erase.setAttribute("aria-pressed", String(!this.brush.isErasing));
    this.app.announce(this.brush.isErasing ? "The brush erases." : "The brush draws.");
  }

  dab(place) {
    this.density.dab(place, this.brush);
    this.send();
    this.show();
  }

  takeBack() {
    if (!this.density.undo()) return;
    this.send();
    this.show();
    this.app.announce("The last stroke is taken back.");
  }

  wipe() {
    this.density.clear();
    this.send();
    this.show();
    this.app.announce("The density is cleared.");
  }

  // One change of the spec for each frame of the screen, however many dabs there are.
  send() {
    if (this.isScheduled) return;
    this.isScheduled = true;
    requestAnimationFrame(async () => {
      this.isScheduled = false;
      if (!this.box) await this.takeBox(this.app.store.get().spec.domain);
      this.app.store.update(({ spec }) => ({ spec: { ...spec, monitor: this.monitor(spec.monitor) } }));
    });
  }

  // The weight alone: the mesh follows what is drawn, so that no error of a function is measured on it.
  monitor(present) {
    const isMine = present.kind === "weight" && Density.of(present.rho);
    if (!isMine) this.before = present;
    const { u: _, ...kept } = present.kind === "weight" ? present : {};
    this.sent = this.density.source(this.box);
    return { ...kept, kind: "weight", rho: this.sent };
  }

  restore() {
    this.finish();
    this.density = new Density();
    const monitor = this.before ?? START.spec.monitor;
    this.before = null;
    this.app.store.update(({ spec }) => ({ spec: { ...spec, monitor } }));
    this.show();
    this.toggle.focus();
  }

  /** The spec has changed: perhaps a link or the gallery brings another density, or the domain is another one. */
  async follow(spec, before) {
    const { kind, rho } = spec.monitor ?? {};
    const own = kind === "weight" ? Density.of(rho) : null;
    if (own && rho !== this.sent) {
      own.before = this.density.before;
      this.density = own;
      this.box = { x: ends(rho.grid.x), y: ends(rho.grid.y) };
      this.sent = rho;
    }
    if (spec.domain !== before.domain) {
      await this.takeBox(spec.domain);
      if (own) this.send();
    }
    this.show();
  }

  // The box of the domain, which the service knows for every kind.
  async takeBox(domain) {
    if (!domain || domain.kind === "rectangle" || !domain.kind) {
      this.box = { x: domain?.x ?? [0, 1], y: domain?.y ?? [0, 1] };
    } else {
      try {
        const { domain: { box } } = await this.app.service.check({ expression: "x", domain });
        this.box = { x: box[0], y: box[1] };
      } catch (error) {
        if (error.name === "AbortError") throw error;
        // The preview tells what is wrong with the domain.
        this.box ??= { x: [0, 1], y: [0, 1] };
      }
    }
    this.surface.box = this.box;
  }

  show() {
    const isMine = this.app.store.get().spec.monitor?.kind === "weight";
    this.undo.disabled = !this.density.before.length;
    this.clear.disabled = this.density.isEmpty;
    this.leave.hidden = !isMine;
    this.surface.draw(this.density, this.brush.radius);
  }
}

function ends(axis) {
  return [axis[0], axis[axis.length - 1]];
}

function slider({ value, min, max, step }, oninput) {
  return element("input", { type: "range", min, max, step, value, oninput });
}
