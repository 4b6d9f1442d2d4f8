// Meshes that take longer than a preview may: requested as meshes that the service keeps, with progress and cancel.

import { element } from "../dom.js";
import { isForMeshes, sentenceOf } from "../remedies.js";
import { duration } from "../words.js";

// The label of the meshes that this page requests.
const LABEL = "workbench";
// Milliseconds until a stream of events that broke off is opened again.
const AGAIN = 1000;
// Seconds that a mesh takes at least, unless it was computed before.
const SHORTEST = 1e-3;
// What is being done, by the stage of the progress.
const STAGES = {
  queued: "waiting for a worker",
  least_error: "descending to the least error",
  start: "making the initial mesh",
  single_domain: "solving on the whole grid",
  schwarz: "solving the subdomains",
  parts: "solving the parts",
  writing: "writing the mesh",
  done: "done",
};

/**
 * The panel of long solves.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const panel = new WorkPanel(app, section);
  section.append(panel.element);
  app.on("problem", (problem) => panel.suggest(problem));
  app.on("request", () => panel.start());
}

class WorkPanel {
  constructor(app, section) {
    Object.assign(this, { app, section, mesh: null, control: null });
    this.hint = element("p", {}, "A preview ends after some seconds. A mesh is computed to its end, and the service keeps it.");
    this.request = element("button", { type: "button", onclick: () => this.start() }, "Request this mesh");
    this.cancel = element("button", { type: "button", hidden: true, onclick: () => this.end() }, "Cancel");
    this.bar = element("progress", { max: "100", value: "0", "aria-label": "Progress of the mesh", hidden: true });
    this.status = element("p", { role: "status", class: "work-status" });
    this.fault = element("p", { class: "fault", role: "alert" });
    this.element = element("div", { class: "work" }, this.hint, element("div", { class: "row" }, this.request, this.cancel), this.bar, this.status, this.fault);
  }

  /** Say so where a mesh is too large or too slow for a preview. */
  suggest(problem) {
    const isTooMuch = Boolean(problem) && isForMeshes(problem);
    this.request.classList.toggle("suggested", isTooMuch);
    if (!isTooMuch || this.control) return;
    this.status.textContent = "This mesh is too much for a preview. Request it here.";
    this.app.announce(this.status.textContent);
  }

  async start() {
    const mine = (this.control = new AbortController());
    const { spec, samples } = this.app.store.get();
    this.fault.textContent = "";
    this.toggle(true);
    this.tell({ stage: "queued" });
    try {
      this.mesh = await this.app.service.requestMesh({ ...spec, label: LABEL }, { samples: samples?.file ?? null, signal: mine.signal });
      if (!this.mesh.finished_at) await this.watch(mine.signal);
      if (this.control !== mine) return;
      await this.finish(await this.app.service.mesh(this.mesh.id), spec);
    } catch (error) {
      if (error.name !== "AbortError" && this.control === mine) this.complain(error.problem ?? { detail: error.message });
    } finally {
      if (this.control === mine) this.toggle(false);
    }
  }

  // Follow the events until the last one. A stream that breaks off is opened again.
  async watch(signal) {
    for (let last = 0; ; ) {
      for await (const { event, data, number } of this.app.service.events(this.mesh.id, { signal, after: last })) {
        last = number;
        if (event === "progress") this.tell(data);
        if (event === "done") return;
      }
      const mesh = await this.app.service.mesh(this.mesh.id, { signal });
      if (mesh.finished_at) return;
      await new Promise((resolve) => setTimeout(resolve, AGAIN));
    }
  }

  /** Show what is being done: a sentence and, where it is known, how much of it is done. */
  tell(progress) {
    const percent = percentOf(progress);
    if (percent === null) this.bar.removeAttribute("value");
    else this.bar.value = percent;
    const doing = progress.phase || STAGES[progress.stage] || progress.stage;
    this.status.textContent = `${percent === null ? "" : `${percent.toFixed(0)} %: `}${doing}`;
    const cancel = { text: "Cancel", act: () => this.end() };
    this.app.notice("problem", { text: `The mesh is computed to its end: ${doing}.`, done: percent ?? 0, of: 100, actions: [cancel] });
  }

  /** Draw a mesh that has ended, unless the page shows another spec by now. */
  async finish(mesh, spec) {
    if (mesh.status === "canceled") {
      this.endCanceled();
      return;
    }
    if (mesh.status === "failed" && !mesh.partial) {
      this.complain(mesh.error ?? { detail: "The mesh failed." });
      return;
    }
    const took = duration(1000 * (mesh.timings?.total ?? 0));
    const isDone = mesh.status === "succeeded";
    const drawing = await this.app.service.drawing(mesh.id);
    if (this.app.store.get().spec !== spec) {
      this.app.notice("problem", null);
      this.status.textContent = `${isDone ? "Done" : "Failed"} after ${took}. The function or its settings have changed, so the mesh is not shown.`;
      return;
    }
    this.app.emit("problem", drawing.document.error ?? null);
    this.app.show({ ...drawing, isQuick: false, milliseconds: 1000 * (mesh.timings?.total ?? 0) });
    const isReused = isDone && !(mesh.timings?.total >= SHORTEST);
    this.status.textContent = `${isReused ? "It had been computed before" : `${isDone ? "Done in" : "Failed after"} ${took}`}: ${mesh.grid ? `${mesh.grid.n_xi} × ${mesh.grid.n_eta}` : mesh.points} points.`;
    this.app.announce(this.status.textContent);
  }

  endCanceled() {
    this.status.textContent = "Canceled.";
    this.app.notice("problem", null);
  }

  /** Cancel the mesh; the events then tell that it has ended. */
  async end() {
    this.cancel.disabled = true;
    if (!this.mesh) {
      this.control.abort();
      this.toggle(false);
      this.endCanceled();
      return;
    }
    try {
      await this.app.service.cancelMesh(this.mesh.id);
    } catch (error) {
      // It had finished before: its drawing comes.
      if (error.problem?.status !== 409) this.complain(error.problem ?? { detail: error.message });
    }
  }

  toggle(isRunning) {
    const isHere = this.element.contains(document.activeElement);
    this.request.hidden = isRunning;
    this.cancel.hidden = !isRunning;
    this.cancel.disabled = false;
    this.bar.hidden = !isRunning;
    if (isRunning) this.mesh = null;
    else this.control = null;
    if (isRunning && isHere) this.cancel.focus();
  }

  complain(problem) {
    const isToldByFaults = (problem.errors ?? []).length > 0;
    this.status.textContent = "";
    this.fault.textContent = [sentenceOf(problem), isToldByFaults ? "" : problem.remedy].filter(Boolean).join(" ");
    this.app.emit("problem", { ...problem, isOfMesh: true });
  }
}

// Done work in percent; null where it is not known.
function percentOf({ fraction, stage }) {
  return typeof fraction === "number" && stage !== "queued" ? 100 * fraction : null;
}
