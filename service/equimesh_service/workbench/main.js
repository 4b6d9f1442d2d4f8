// The workbench: builds the app object and all panels.

import { faultOf, followAddress, stateOf } from "./address.js";
import { createStage } from "./drawing/stage.js";
import { createLive } from "./live.js";
import { createNotice } from "./notice.js";
import { actionsOf, sentenceOf } from "./remedies.js";
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
import * as setupPanel from "./panels/setup.js";
import * as sketchPanel from "./panels/sketch.js";
import * as takePanel from "./panels/take.js";
import * as timePanel from "./panels/time.js";
import * as viewPanel from "./panels/view.js";
import * as workPanel from "./panels/work.js";

// In the order of the page; a name is that of the section `panel-<name>`.
const PANELS = {
  function: functionPanel,
  setup: setupPanel,
  view: viewPanel,
  take: takePanel,
  gallery: galleryPanel,
  numbers: numbersPanel,
  domain: domainPanel,
  monitor: monitorPanel,
  grid: gridPanel,
  samples: samplesPanel,
  sketch: sketchPanel,
  time: timePanel,
  schwarz: schwarzPanel,
  iteration: iterationPanel,
  copy: copyPanel,
  downloads: downloadsPanel,
  work: workPanel,
  key: keyPanel,
};
// Milliseconds without another announcement until a screen reader is told the last one.
const SETTLED = 700;
// What is grey while it is the answer to another question.
const ANSWERS = ["stage", "headline", "panel-numbers", "status"];

const byId = (id) => document.getElementById(id);

/**
 * The object that all panels share.
 *
 * `store`, `service`, `live` and `canvas` (the stage) are the parts of the page; `drawing` is the last drawing,
 * `{arrays, document, isQuick, milliseconds}`, or null.  `on(name, listener)` listens to "drawing", "busy" (true or
 * false), "stale" (true while what is shown answers another question), "request" (the mesh in place of a preview) and
 * "problem" (the body of a problem, or null); it returns a function that ends it.  `show(drawing)` draws one.
 * `announce(text)` tells it to screen readers, `status(text)` also to everyone else, and `notice(source, notice)` shows
 * it over the figure.  `change(state)` changes the state by an entry of its own in the history of the browser.
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
      app.emit("stale", false);
      app.emit("drawing", drawing);
    },
    change(state) {
      app.address?.step();
      app.store.update(state);
    },
    notice: createNotice(byId("notice")).tell,
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
  app.on("stale", (isStale) => ANSWERS.forEach((id) => byId(id).classList.toggle("stale", isStale)));
  tellProblems(app);
  const follow = (hash) => tellOfLink(app, faultOf(hash));
  app.address = followAddress(app.store, (hash) => queueMicrotask(() => follow(hash)));
  app.store.subscribe((state, before) => state.spec !== before.spec && ["link", "domain"].forEach((source) => app.notice(source, null)));
  follow(location.hash);
  app.live.refresh();
}

// What is wrong with the request, unless it is told at the function; the last mesh stays.
function tellProblems(app) {
  app.on("problem", (problem) => {
    const isElsewhere = !problem || (problem.errors ?? []).some(({ pointer = "" }) => isOfFunction(app, pointer));
    app.notice("problem", isElsewhere ? null : { text: sentenceOf(problem), actions: actionsOf(app, problem) });
  });
}

function isOfFunction({ store }, pointer) {
  const place = functionPanel.sourcePath(store.get().spec);
  return place !== null && `${pointer}/`.startsWith(`/${place.slice(1).join("/")}/`);
}

function tellOfLink(app, fault) {
  const close = { text: "Close", act: () => app.notice("link", null) };
  app.notice("link", fault && { text: `${fault} The first problem is shown in its place.`, actions: [close] });
}

main();
