// The figure: the renderer, the camera, the cell under the pointer, and what is drawn over the mesh.

import { element } from "../dom.js";
import { amount } from "../words.js";
import { boxOf, createCamera } from "./camera.js";
import { tableOf } from "../browser/colours.js";
import { followGestures } from "./gestures.js";
import { followCells } from "./hover.js";
import { meshOf } from "./nodes.js";
import { createRenderer } from "./renderer.js";
import { errorsOf, placesOf, valuesOf } from "./values.js";

// The space between two panes, and over each for its caption, in pixels.
const GAP = 10;
const CAPTION = 30;
// Milliseconds without a movement until all details are drawn; at least so many times as long as the last frame took.
const REST = 140;
const PACES = 3;
// Pixels of the canvas for each of the page: more are not seen, and cost time.
const MOST_RATIO = 2;

/**
 * The stage, `app.canvas`.
 *
 * `overlay` is an SVG over the mesh, in pixels of the stage, in which panels may draw; `toPane(point, k)` and
 * `toDomain(pixel)` convert between points of the domain and pixels of the stage.  `redraw()` draws with the next
 * frame; `move()` does, too, with fewer details where they cost too much, and with all of them when nothing moves any
 * more.  `on(listener)` is called after each frame.  `frames` counts them.
 *
 * @param {HTMLElement} stage
 * @param {object} app
 */
export function createStage(stage, app) {
  const canvas = stage.querySelector("canvas");
  const overlay = stage.querySelector("svg");
  const renderer = createRenderer(canvas, { isPlain: new URLSearchParams(location.search).has("plain") });
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const listeners = new Set();
  const self = {
    stage,
    overlay,
    renderer,
    /** Pixels of the stage: to read them of the page in each frame would lay it out anew. */
    width: stage.clientWidth,
    height: stage.clientHeight,
    camera: createCamera(),
    mesh: null,
    errors: null,
    coloured: null,
    table: null,
    panes: [],
    /** What each pane shows, as a name and more words. */
    captions: [],
    frames: 0,
    /** A blend that is drawn in place of that of the view, while nodes travel; else null. */
    journey: null,
    /** Whether frames follow each other; texts wait until they do not. */
    isMoving: false,
    isDark: () => dark.matches,
    redraw,
    move,
    colour,
    on(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
    /** The pane [pane, pixel in the pane] under a pixel of the stage. */
    paneAt([px, py]) {
      const found = self.panes.find((pane) => px < pane.left + pane.width + GAP / 2 && py < pane.top + pane.height + GAP / 2);
      const pane = found ?? self.panes.at(-1);
      return [pane, [px - pane.left, py - pane.top]];
    },
    toPane(point, k = self.panes.length - 1) {
      const [px, py] = self.camera.toPane(point);
      return [px + self.panes[k].left, py + self.panes[k].top];
    },
    toDomain: (pixel) => self.camera.toDomain(self.paneAt(pixel)[1]),
    /** Draw at once, as before a picture of the canvas is taken. */
    drawNow() {
      self.isMoving = false;
      draw();
    },
  };
  let isScheduled = false;
  let uploads = 0; // of nodes to the renderer
  let drawings = 0;
  let isFresh = false; // a drawing that no frame has shown
  let restTimer = 0;
  let lastDrawn = 0;
  let paper = null; // the background, which only the theme changes

  function redraw() {
    if (isScheduled) return;
    isScheduled = true;
    requestAnimationFrame(draw);
  }

  function move() {
    self.isMoving = true;
    clearTimeout(restTimer);
    redraw();
  }

  function rest() {
    self.isMoving = false;
    redraw();
  }

  function draw() {
    isScheduled = false;
    const { view } = app.store.get();
    arrange(self, view);
    const ratio = canvas.width / Math.max(1, self.width);
    const { isMoving } = self;
    const drawn = renderer.draw(self.panes, self.camera, { ratio, lines: view.lines, ink: null, paper: paper ?? [1, 1, 1], isMoving });
    // On a slow machine movements are further apart; the time counts from a frame that was drawn.
    clearTimeout(restTimer);
    const pace = Math.min(REST, performance.now() - lastDrawn);
    if (isMoving) restTimer = setTimeout(rest, Math.max(REST, PACES * pace));
    lastDrawn = performance.now();
    self.frames += 1;
    Object.assign(stage.dataset, { frames: self.frames, ...drawn });
    stage.classList.toggle("zoomed", self.camera.zoom > 1);
    if (isFresh) tell();
    for (const listener of listeners) listener();
  }

  // What is drawn now, as attributes of the stage, from where tests read it.
  function tell() {
    isFresh = false;
    drawings += 1;
    Object.assign(stage.dataset, { drawings, uploads, points: self.mesh.shape.join(" "), quick: Boolean(app.drawing.isQuick) });
  }

  function resize() {
    const ratio = Math.min(MOST_RATIO, devicePixelRatio || 1);
    Object.assign(self, { width: stage.clientWidth, height: stage.clientHeight });
    canvas.width = Math.max(1, Math.round(self.width * ratio));
    canvas.height = Math.max(1, Math.round(self.height * ratio));
    draw();
  }

  function colour() {
    if (!self.mesh) return;
    self.coloured = valuesOf(app.drawing, self.mesh, app.store.get().view.colour);
    paper ??= getComputedStyle(stage).backgroundColor.match(/[\d.]+/g).slice(0, 3).map((value) => value / 255);
    self.table = tableOf(self.coloured.name, dark.matches);
    renderer.setColours({ table: self.table, ...placesOf(self.coloured, self.mesh) });
    redraw();
  }

  app.on("drawing", (drawing) => {
    const mesh = meshOf(drawing);
    if (!mesh) return;
    self.mesh = mesh;
    self.errors = errorsOf(drawing);
    renderer.setNodes(mesh);
    uploads += 1;
    self.camera.setBox(boxOf([mesh.x, mesh.y], [mesh.uniformX, mesh.uniformY]));
    colour();
    if (drawing.isLocal) move(); // looks follow each other while the hand types
    isFresh = true;
  });
  app.on("busy", (isBusy) => stage.classList.toggle("busy", isBusy));
  app.store.subscribe((state, before) => {
    if (state.view.colour !== before.view.colour) colour();
    else if (state.view !== before.view) redraw();
  });
  dark.addEventListener("change", () => {
    paper = null;
    colour();
  });
  new ResizeObserver(resize).observe(stage);
  followGestures(self);
  followCells(self, app);
  followCaptions(self, app, stage.querySelector("#captions"));
  return self;
}

// One pane, or one for each mesh: next to each other or below each other, whichever shows them larger.
function arrange(self, view) {
  const { width, height } = self;
  const blend = self.journey ?? view.blend;
  if (view.layout !== "pair") {
    self.camera.resize(width, height - CAPTION);
    self.panes = [{ left: 0, top: CAPTION, width, height: height - CAPTION, blend }];
    return;
  }
  const [half, high, low] = [(width - GAP) / 2, height - CAPTION, height / 2 - CAPTION];
  self.camera.resize(half, high);
  const aside = self.camera.scale;
  self.camera.resize(width, low);
  if (aside >= self.camera.scale) {
    self.camera.resize(half, high);
    const places = [0, half + GAP];
    self.panes = places.map((left, k) => ({ left, top: CAPTION, width: half, height: high, blend: k * blend }));
  } else {
    const places = [CAPTION, height / 2 + CAPTION];
    self.panes = places.map((top, k) => ({ left: 0, top, width, height: low, blend: k * blend }));
  }
}

// What each pane shows, in its corner.
function followCaptions(self, app, place) {
  let shown = "";
  self.on(() => {
    const texts = app.drawing ? self.panes.map((pane, k) => app.drawing.captions?.[k] ?? captionOf(pane, self)) : [];
    self.captions = texts;
    const key = JSON.stringify([texts, self.panes]);
    if (key === shown) return;
    shown = key;
    place.replaceChildren(
      ...texts.map(([name, more], k) =>
        element("span", { style: placeOf(self.panes[k]) }, element("b", {}, name), more),
      ),
    );
  });
}

function placeOf({ left, top, width }) {
  return { left: `${left}px`, top: `${top - CAPTION}px`, width: `${width}px` };
}

function captionOf({ blend }, { errors, isMoving, mesh }) {
  if (blend !== 0 && !mesh?.isAdapted) return ["no mesh", `, the ${mesh?.isOfBlocks ? "initial" : "uniform"} one is shown`];
  const text = (name) => (errors?.[name] ? `, interpolation error ${amount(errors[name])}` : "");
  if (blend === 0) return [mesh?.isOfBlocks ? "initial" : "uniform", text("l2_uniform")];
  if (blend === 1) return ["adapted", text("l2")];
  return [isMoving ? "between both" : `${Math.round(100 * blend)} % of the way`, ""];
}
