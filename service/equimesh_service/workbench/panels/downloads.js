// The panel of downloads: the mesh as a file of any format, and the picture.

import { capabilitiesOf } from "../capabilities.js";
import { element } from "../dom.js";
import { pngOf, svgOf } from "../drawing/picture.js";
import { save } from "./take.js";

// The label of the meshes that this page requests.
const LABEL = "workbench";
// Seconds for which one request waits for a mesh.
const WAIT = 10;
const PICTURES = [
  { suffix: ".svg", text: "SVG", make: svgOf },
  { suffix: ".png", text: "PNG", make: pngOf },
];

/**
 * The panel of downloads.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const panel = new DownloadsPanel(app);
  section.append(panel.element);
  app.on("download", (format) => panel.download(format));
  panel.listFormats();
}

class DownloadsPanel {
  constructor(app) {
    Object.assign(this, { app, control: null, finished: null });
    this.formats = element("div", { class: "formats" });
    this.status = element("p", { class: "download-status", role: "status" });
    this.fault = element("p", { class: "fault", role: "alert" });
    this.cancel = element("button", { type: "button", hidden: true, onclick: () => this.control?.abort() }, "Cancel");
    const pictures = PICTURES.map(({ suffix, text, make }) =>
      element("button", { type: "button", onclick: () => this.picture(suffix, make) }, text));
    const spec = element("button", { type: "button", onclick: () => this.spec() }, "Spec (JSON)");
    this.element = element("div", {},
      element("h3", {}, "The mesh"),
      this.formats,
      element("div", { class: "row" }, this.status, this.cancel),
      this.fault,
      element("h3", {}, "The picture, and what was requested"),
      element("div", { class: "row" }, pictures, spec));
  }

  async listFormats() {
    try {
      const { formats } = await capabilitiesOf(this.app);
      this.formats.replaceChildren(...formats.map((format) => this.row(format)));
    } catch (error) {
      this.tell(error);
    }
  }

  row(format) {
    const { name, suffix, description } = format;
    const button = element("button", { type: "button", "aria-label": `Download the mesh as ${name}` }, `mesh${suffix}`);
    button.addEventListener("click", () => this.download(format));
    return element("div", { class: "format" }, button, element("span", { class: "hint" }, description));
  }

  /** The file of the mesh that the page shows, as one that the service keeps. */
  async download({ name, suffix }) {
    this.control?.abort();
    const control = (this.control = new AbortController());
    this.fault.textContent = "";
    this.cancel.hidden = false;
    try {
      const id = await this.mesh(control.signal);
      this.say(`Downloading mesh${suffix}.`);
      save(await this.app.service.file(id, name, { signal: control.signal }), `mesh${suffix}`);
      this.say(`mesh${suffix} is downloaded.`);
    } catch (error) {
      if (this.control !== control) return; // another download has begun
      this.say(error.name === "AbortError" ? "Canceled." : "");
      if (error.name !== "AbortError") this.tell(error);
    } finally {
      if (this.control === control) {
        this.control = null;
        this.cancel.hidden = true;
      }
    }
  }

  // The id of a finished mesh of the present spec; it is computed once for all formats.
  async mesh(signal) {
    const { spec, samples } = this.app.store.get();
    if (this.finished?.spec === spec) return this.finished.id;
    this.say("Computing the mesh.");
    const { service } = this.app;
    let mesh = await service.requestMesh({ ...spec, label: spec.label ?? LABEL }, { samples: samples?.file ?? null, wait: WAIT, signal });
    try {
      while (!mesh.finished_at) {
        const { fraction, phase } = mesh.progress ?? {};
        const done = typeof fraction === "number" && phase ? `, ${Math.round(100 * fraction)} %` : "";
        this.say(`Computing the mesh${phase ? `: ${phase}` : ""}${done}.`);
        mesh = await service.mesh(mesh.id, { wait: WAIT, signal });
      }
    } catch (error) {
      if (error.name === "AbortError") await service.cancelMesh(mesh.id).catch(() => {}); // it may have finished
      throw error;
    }
    if (mesh.status !== "succeeded") throw new Failure(mesh);
    this.finished = { spec, id: mesh.id };
    return mesh.id;
  }

  // In this panel, and next to the mesh.
  say(text) {
    this.status.textContent = text;
    this.app.emit("downloading", text);
  }

  async picture(suffix, make) {
    this.fault.textContent = "";
    if (!this.app.drawing) this.fault.textContent = "There is no picture yet.";
    else save(await make(this.app), `mesh${suffix}`);
  }

  spec() {
    const text = JSON.stringify(this.app.store.get().spec, null, 2);
    save(new Blob([text, "\n"], { type: "application/json" }), "spec.json");
  }

  tell(error) {
    const problem = error.problem ?? {};
    if (problem.status === 410 || problem.status === 404) this.finished = null; // it was removed: the next click computes it anew
    const faults = (problem.errors ?? []).map((each) => each.message);
    this.fault.textContent = [problem.detail ?? error.message, ...(faults.length ? faults : [problem.remedy])].filter(Boolean).join(" ");
    this.app.emit("downloading", faults[0] ?? problem.detail ?? error.message);
  }
}

// A mesh that did not succeed, with the problem that the service tells.
class Failure extends Error {
  constructor({ error, status }) {
    super(error?.detail ?? `The mesh was ${status}.`);
    this.problem = error ?? {};
  }
}
