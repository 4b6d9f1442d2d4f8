// Numbers or a picture of the visitor as the function u.

import { element, field } from "../dom.js";
import { greySamples } from "../grey.js";
import { START } from "../store.js";

// Files of numbers, in the formats that the service reads.
const NUMBERS = [".csv", ".txt", ".npz", ".npy", ".vtu", ".vtk", ".json"];
// Pictures, which the browser turns into grey values.
const PICTURES = ["image/png", "image/jpeg", "image/webp", "image/gif", "image/bmp"];
// Kinds of monitors that do not follow u: with samples as u, the usual monitor takes their place.
const WITHOUT_U = new Set(["weight", "tensor", "intersection", "nodal_solution"]);
// A line of a file with a fault is shown up to this many characters.
const LONGEST_LINE = 80;

/**
 * The panel of the visitor's own data.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  const panel = new SamplesPanel(app);
  section.append(panel.element);
  panel.catchDrops(document);
  app.store.subscribe((state, before) => {
    if (state.spec !== before.spec || state.samples !== before.samples) panel.follow();
  });
  panel.follow();
}

class SamplesPanel {
  constructor(app) {
    this.app = app;
    this.before = null;
    this.input = element("input", { type: "file", accept: [...NUMBERS, ...PICTURES].join(","), onchange: () => this.choose() });
    this.hasProportions = element("input", { type: "checkbox" });
    this.fault = element("p", { class: "fault", role: "alert" });
    this.line = element("pre", { class: "fault-line", hidden: true });
    this.columns = element("div", { class: "columns", role: "group", "aria-label": "Columns of the file", hidden: true });
    this.facts = element("dl", { class: "samples-facts" });
    const remove = element("button", { type: "button", onclick: () => this.remove() }, "Remove the samples");
    this.present = element("div", { hidden: true }, this.facts, remove);
    this.element = element("div", { class: "samples" },
      element("p", {}, "Choose a file, or drop it anywhere on the page. It becomes u."),
      field("File of samples, or picture", this.input, {
        help: "Numbers: csv or txt (x, y, u), npz, npy, vtu, vtk, json. Pictures: PNG, JPEG, as grey values.",
      }),
      field("Give the domain the proportions of a picture", this.hasProportions, { inline: true }),
      this.fault, this.line, this.columns, this.present);
  }

  catchDrops(page) {
    const isFile = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
    page.addEventListener("dragover", (event) => {
      if (!isFile(event)) return;
      event.preventDefault();
      page.body.classList.add("dropping");
    });
    page.addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) page.body.classList.remove("dropping");
    });
    page.addEventListener("drop", (event) => {
      if (!isFile(event)) return;
      event.preventDefault();
      page.body.classList.remove("dropping");
      this.element.closest("details")?.setAttribute("open", "");
      const [file] = event.dataTransfer.files;
      if (file) this.take(file);
    });
  }

  choose() {
    const [file] = this.input.files;
    // The same file can be chosen again after it was changed.
    if (file) this.take(file).finally(() => (this.input.value = ""));
  }

  /** Send a file to the service, and take the samples, or a `column` of them, for u. */
  async take(file, column = null) {
    this.complain(null);
    this.request?.abort();
    const mine = (this.request = new AbortController());
    this.element.setAttribute("aria-busy", "true");
    try {
      const picture = PICTURES.includes(file.type) ? await greySamples(file) : null;
      const sent = picture ? new File([picture.file], `${file.name}.npy`, { type: "application/x-npy" }) : file;
      const stored = await this.app.service.uploadSamples(sent, { column, signal: mine.signal });
      if (this.request === mine) this.use(stored, file, picture);
    } catch (error) {
      if (this.request === mine) await this.complain(error, file);
    } finally {
      if (this.request === mine) this.element.removeAttribute("aria-busy");
    }
  }

  use(stored, file, picture) {
    const { spec } = this.app.store.get();
    this.before ??= spec;
    const { kind, ...settings } = spec.monitor;
    const u = { samples: stored.id };
    const monitor = WITHOUT_U.has(kind) ? { u } : { ...settings, ...(kind ? { kind } : {}), u };
    const domain = picture && this.hasProportions.checked ? { kind: "rectangle", ...proportions(picture) } : spec.domain;
    this.app.store.update({
      spec: { ...spec, monitor, ...(domain ? { domain } : {}) },
      samples: { id: stored.id, name: file.name, stored },
    });
    this.app.announce(`${file.name} is u now: ${stored.shape.join(" by ")} samples.`);
  }

  remove() {
    const { spec } = this.app.store.get();
    const { monitor, domain } = this.before ?? START.spec;
    const { domain: _, ...rest } = spec;
    this.app.store.update({ spec: { ...rest, monitor, ...(domain ? { domain } : {}) }, samples: null });
    this.before = null;
    this.complain(null);
    this.app.announce("The samples are removed.");
    this.input.focus();
  }

  /** The samples of the spec, also those that a link names. */
  async follow() {
    const { spec, samples } = this.app.store.get();
    const id = spec.monitor?.u?.samples;
    this.present.hidden = !id || id === "upload";
    if (this.present.hidden) {
      this.before = this.shown = null;
      return;
    }
    if (samples?.id === id) {
      this.tell(samples.name, samples.stored);
      return;
    }
    if (this.shown === id) return;
    this.tell("of this link", null);
    this.shown = id; // asked for once, whatever the answer
    try {
      const stored = await this.app.service.json(`v1/samples/${encodeURIComponent(id)}`);
      if (this.app.store.get().spec.monitor?.u?.samples === id) this.tell("of this link", stored);
    } catch (error) {
      this.complain(error);
    }
  }

  tell(name, stored) {
    this.shown = stored?.id ?? null;
    const facts = { samples: name };
    if (stored) {
      facts.size = `${stored.shape.join(" × ")} (${stored.kind === "grid" ? "a grid" : stored.kind}), ${bytes(stored.size)}`;
      facts.range = `${stored.min.toPrecision(4)} to ${stored.max.toPrecision(4)}`;
    }
    this.facts.replaceChildren(...Object.entries(facts).flatMap(([term, text]) => [element("dt", {}, term), element("dd", {}, text)]));
  }

  /** Ask which column of a file is u. */
  ask(file, columns) {
    this.fault.textContent = "";
    const buttons = columns.map((column) => element("button", { type: "button", onclick: () => this.take(file, column) }, column));
    this.columns.replaceChildren(element("p", {}, `Which column of ${file.name} is u?`), element("div", { class: "row" }, buttons));
    this.columns.hidden = false;
    this.app.announce(`Which column of ${file.name} is u?`);
    this.element.closest("details")?.setAttribute("open", "");
  }

  // What is wrong, and the line of the file where the service names one.
  async complain(error, file = null) {
    this.line.hidden = this.columns.hidden = true;
    if (!error) {
      this.fault.textContent = "";
      return;
    }
    if (error.name === "AbortError") return;
    const columns = file && (error.problem?.errors ?? []).find((one) => one.columns?.length)?.columns;
    if (columns) {
      this.ask(file, columns);
      return;
    }
    const faults = (error.problem?.errors ?? []).map(({ message }) => message);
    const text = faults.length ? faults.join("; ") : [error.message, error.problem?.remedy].filter(Boolean).join(" ");
    this.fault.textContent = file ? `${file.name}: ${text}` : text;
    const number = Number(/\bline (\d+) of the csv/.exec(text)?.[1] ?? 0);
    if (!number || !file) return;
    const line = (await file.text()).split(/\r?\n/)[number - 1] ?? "";
    this.line.textContent = `${number}: ${line.slice(0, LONGEST_LINE)}`;
    this.line.hidden = false;
  }
}

function proportions({ width, height }) {
  const longer = Math.max(width, height);
  const side = (pixels) => [0, Number((pixels / longer).toPrecision(4))];
  return { x: side(width), y: side(height) };
}

function bytes(size) {
  return size < 1000 ? `${size} bytes` : size < 1e6 ? `${(size / 1e3).toFixed(0)} kB` : `${(size / 1e6).toFixed(1)} MB`;
}
