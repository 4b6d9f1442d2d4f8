// The workbench: builds the app object and all panels.

import { followAddress, stateOf } from "./address.js";
import { createStage } from "./drawing/stage.js";
import { createLive } from "./live.js";
import { createService } from "./service.js";
import { alone, createStore } from "./store.js";
import * as copyPanel from "./panels/copy.js";
import * as domainPanel from "./panels/domain.js";
import * as downloadsPanel from "./panels/downloads.js";
import * as functionPanel from "./panels/function.js";
import * as galleryPanel from "./panels/gallery.js";
import * as gridPanel from "./panels/grid.js";
import * as iterationPanel from "./panels/iteration.js";
import * as keyPanel from "./panels/key.js";
import * as monitorPanel from "./panels/monitor.js";
import * as numbersPanel from "./panels/numbers.js";
import * as samplesPanel from "./panels/samples.js";
import * as schwarzPanel from "./panels/schwarz.js";
import * as sketchPanel from "./panels/sketch.js";
import * as timePanel from "./panels/time.js";
import * as viewPanel from "./panels/view.js";
import * as workPanel from "./panels/work.js";

// In the order of the page; a name is that of the section `panel-<name>`.
const PANELS = {
  function: functionPanel,
  view: viewPanel,
  numbers: numbersPanel,
  gallery: galleryPanel,
  monitor: monitorPanel,
  domain: domainPanel,
  grid: gridPanel,
  schwarz: schwarzPanel,
  iteration: iterationPanel,
  time: timePanel,
  samples: samplesPanel,
  sketch: sketchPanel,
  copy: copyPanel,
  downloads: downloadsPanel,
  work: workPanel,
  key: keyPanel,
};
// Milliseconds without another announcement until a screen reader is told the last one.
const SETTLED = 700;

const byId = (id) => document.getElementById(id);

/**
 * The object that all panels share.
 *
 * `store`, `service`, `live` and `canvas` (the stage) are the parts of the page; `drawing` is the last drawing,
 * `{arrays, document, isQuick, milliseconds}`, or null.  `on(name, listener)` listens to "drawing", "busy" (true or
 * false) and "problem" (the body of a problem, or null); it returns a function that ends it.  `show(drawing)` draws one.
 * `announce(text)` tells it to screen readers, `status(text)` also to everyone else.
 */
function createApp() {
  const listeners = new Map();
  let announcement = 0;
  const app = {
    store: createStore(stateOf(location.hash)),
    service: createService(),
    drawing: null,
    problem: null,
    on(name, listener) {
      if (!listeners.has(name)) listeners.set(name, new Set());
      listeners.get(name).add(listener);
      return () => listeners.get(name).delete(listener);
    },
    emit(name, value) {
      if (name === "problem") app.problem = value;
      for (const listener of [...(listeners.get(name) ?? [])]) alone(() => listener(value));
    },
    show(drawing) {
      app.drawing = drawing;
      app.emit("drawing", drawing);
    },
    announce(text) {
      clearTimeout(announcement);
      announcement = setTimeout(() => (byId("live").textContent = text), SETTLED);
    },
    status(text) {
      byId("status").textContent = text;
    },
  };
  return app;
}

function main() {
  const app = createApp();
  app.canvas = createStage(byId("stage"), app);
  app.live = createLive(app);
  for (const [name, panel] of Object.entries(PANELS)) {
    const section = byId(`panel-${name}`);
    alone(() => panel.create(section.querySelector(".content"), app));
    section.hidden = false;
  }
  followAddress(app.store);
  app.live.refresh();
}

main();
