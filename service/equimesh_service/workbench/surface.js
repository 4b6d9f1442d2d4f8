// A surface over the mesh that takes strokes of a brush, by mouse, touch, pen and keyboard.

import { element } from "./dom.js";

// How far an arrow key moves the brush, in units of its radius; with Shift a tenth of it.
const KEY_MOVE = 0.5;
const FINE = 0.1;
// Dabs of a stroke are at most this far from each other, in units of the radius.
const SPACING = 0.4;
// The opacity of the largest density.
const DARKEST = 0.6;
// The keys that move the brush, as steps in x and y.
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** A canvas over the stage. It calls `onDab(place)`, between `onBegin()` and `onEnd()`; places are shares of the box. */
export class Surface {
  constructor(stage, { onBegin, onDab, onEnd, onUndo, describedby }) {
    Object.assign(this, { stage, onBegin, onDab, onEnd, onUndo, place: { s: 0.5, t: 0.5 }, last: null });
    this.canvas = element("canvas", {
      class: "surface", tabindex: "0", role: "application", "aria-roledescription": "drawing surface",
      "aria-label": "Density", "aria-describedby": describedby, hidden: true,
    });
    stage.stage.append(this.canvas);
    stage.on(() => this.redraw());
    this.listen();
  }

  get isOpen() {
    return !this.canvas.hidden;
  }

  open(box) {
    this.box = box;
    this.canvas.hidden = false;
    this.canvas.focus({ preventScroll: true });
  }

  close() {
    this.canvas.hidden = true;
    this.last = null;
  }

  listen() {
    const { canvas } = this;
    // The stage below would pan.
    for (const name of ["pointerdown", "pointermove", "pointerup", "keydown"]) canvas.addEventListener(name, (event) => event.stopPropagation());
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      canvas.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      this.begin(this.placeOf(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      const events = event.getCoalescedEvents?.() ?? [];
      for (const each of events.length ? events : [event]) this.move(this.placeOf(each));
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => this.end());
    canvas.addEventListener("keydown", (event) => this.press(event));
  }

  begin(place) {
    this.onBegin();
    this.last = this.place = place;
    this.onDab(place);
  }

  // Dabs close to each other, so that a quick stroke has no gaps.
  move(place) {
    this.place = place;
    if (this.last) {
      const [ds, dt] = [place.s - this.last.s, place.t - this.last.t];
      const count = Math.floor(Math.hypot(ds, dt) / (SPACING * this.radius));
      const from = this.last;
      for (let k = 1; k <= count; k += 1) {
        this.last = { s: from.s + (ds * k) / count, t: from.t + (dt * k) / count };
        this.onDab(this.last);
      }
    }
    this.redraw();
  }

  end() {
    if (!this.last) return;
    this.last = null;
    this.onEnd();
  }

  press(event) {
    if (event.key in ARROWS) {
      const [right, up] = ARROWS[event.key];
      const by = this.radius * (event.shiftKey ? FINE : KEY_MOVE);
      const inside = (share) => Math.min(1, Math.max(0, share));
      this.place = { s: inside(this.place.s + right * by), t: inside(this.place.t + up * by) };
      this.redraw();
    } else if (event.key === " " || event.key === "Enter") {
      this.begin(this.place);
      this.end();
    } else if (event.key.toLowerCase() === "z" && !event.altKey) {
      this.onUndo();
    } else {
      return;
    }
    event.preventDefault();
  }

  placeOf(event) {
    const frame = this.canvas.getBoundingClientRect();
    const [x, y] = this.stage.toDomain([event.clientX - frame.left, event.clientY - frame.top]);
    const share = (value, [first, last]) => (value - first) / (last - first);
    return { s: share(x, this.box.x), t: share(y, this.box.y) };
  }

  /** Draw the density and the ring of the brush, in both panes of the stage. */
  draw(density, radius) {
    Object.assign(this, { density, radius });
    this.redraw();
  }

  redraw() {
    if (!this.isOpen || !this.density) return;
    const { canvas, density, box } = this;
    const { clientWidth: width, clientHeight: height } = canvas;
    const ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const picture = pictureOf(density, getComputedStyle(canvas).color);
    for (const [k, pane] of this.stage.panes.entries()) {
      context.save();
      context.beginPath();
      context.rect(pane.left, pane.top, pane.width, pane.height);
      context.clip();
      this.drawIn(context, k, picture);
      context.restore();
    }
  }

  drawIn(context, pane, picture) {
    const { box, place, radius } = this;
    const at = (s, t) =>
      this.stage.toPane([box.x[0] + s * (box.x[1] - box.x[0]), box.y[0] + t * (box.y[1] - box.y[0])], pane);
    // The samples are the nodes of the grid, so the picture reaches half a spacing beyond the box.
    const half = 0.5 / (this.density.side - 1);
    const [left, top] = at(-half, 1 + half);
    const [right, bottom] = at(1 + half, -half);
    context.drawImage(picture, left, top, right - left, bottom - top);
    const [x, y] = at(place.s, place.t);
    const [beyond, above] = at(place.s + radius, place.t + radius);
    context.strokeStyle = getComputedStyle(this.canvas).color;
    context.lineWidth = 2;
    context.beginPath();
    context.ellipse(x, y, Math.abs(beyond - x), Math.abs(above - y), 0, 0, 2 * Math.PI);
    context.stroke();
  }
}

// The density as a small picture in one colour, the more opaque the larger it is.
function pictureOf(density, colour) {
  const { side, values, largest } = density;
  const picture = new OffscreenCanvas(side, side);
  const context = picture.getContext("2d");
  context.fillStyle = colour;
  context.fillRect(0, 0, side, side);
  const image = context.getImageData(0, 0, side, side);
  for (let i = 0; i < side; i += 1) {
    for (let j = 0; j < side; j += 1) {
      const share = largest > 1 ? Math.log(values[i * side + j]) / Math.log(largest) : 0;
      image.data[4 * ((side - 1 - j) * side + i) + 3] = 255 * DARKEST * share;
    }
  }
  context.putImageData(image, 0, 0);
  return picture;
}
