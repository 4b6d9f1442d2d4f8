// The forms of domains that are meshes of blocks: a description as JSON, and the file of a mesh.

import { follow, numberField } from "../bound.js";
import { element, field, freshId } from "../dom.js";

/** The descriptions that a change of the kind begins with: a square with a round hole, one with an interface and a layer. */
export const FIRST = {
  blocks: {
    vertices: { a: [-1, -1], b: [1, -1], c: [1, 1], d: [-1, 1], e: [-0.25, -0.25], f: [0.25, -0.25], g: [0.25, 0.25], h: [-0.25, 0.25] },
    curves: { hole: { circle: { center: [0, 0], radius: 0.3535533905932738 } } },
    edges: [
      { from: "e", to: "f", on: "hole" },
      { from: "f", to: "g", on: "hole" },
      { from: "g", to: "h", on: "hole" },
      { from: "h", to: "e", on: "hole" },
    ],
    blocks: [
      { corners: ["a", "b", "f", "e"], cells: [16, 16] },
      { corners: ["b", "c", "g", "f"], cells: [16, 16] },
      { corners: ["c", "d", "h", "g"], cells: [16, 16] },
      { corners: ["d", "a", "e", "h"], cells: [16, 16] },
    ],
    sides: { hole: [["e", "f"], ["f", "g"], ["g", "h"], ["h", "e"]] },
  },
  fixed_rectangle: {
    cells: [32, 32],
    points: [[0.25, 0.3]],
    curves: { interface: { x: "t", y: "0.6 + 0.05*sin(2*pi*t)" } },
    layers: { bottom: { first: 0.005, growth: 1.3, count: 5 } },
  },
};

// What is said above the text.
const HINTS = {
  blocks: "Vertices, curves, blocks and sides by their names. The mesh slides along the curves and through the blocks.",
  fixed_rectangle: "Nodes stay at the points, and slide on the curves from side to side. Layers give cells along a side their heights.",
};

/**
 * The form of a description: a text of JSON that follows the spec, and a file that takes its place.
 *
 * @param {object} app
 * @param {(domain: object) => void} put
 * @param {string} kind of the domain
 */
export function descriptionForm(app, put, kind) {
  const input = element("textarea", { rows: 14, class: "code", spellcheck: "false", id: freshId(kind) });
  const box = field(kind === "blocks" ? "Description, as JSON" : "Rectangle, as JSON", input);
  const fault = box.querySelector(".fault");
  const take = (text) => {
    const read = descriptionIn(text);
    fault.textContent = read.fault ?? "";
    if (read.description) put({ kind, ...read.description });
  };
  const file = element("input", { type: "file", accept: ".json,application/json" });
  file.addEventListener("change", async () => {
    if (!file.files.length) return;
    input.value = await file.files[0].text();
    take(input.value);
    file.value = "";
  });
  input.addEventListener("input", () => take(input.value));
  follow(app, ["domain"], (domain) => {
    if (domain?.kind !== kind) return;
    const { kind: _, refine: __, ...description } = domain;
    const shown = descriptionIn(input.value).description;
    if (shown && JSON.stringify(withoutRefine(shown)) === JSON.stringify(description)) return;
    input.value = textOf(description);
    fault.textContent = "";
  });
  return element("div", {},
    element("p", { class: "hint" }, HINTS[kind]),
    kind === "blocks" ? numberField(app, "Cells, times", ["domain", "refine"], { fallback: 1, min: 0.1 }) : "",
    box,
    field(kind === "blocks" ? "Or open a description" : "Or open a file of it", file));
}

/**
 * The form of a mesh file, which the service keeps.
 *
 * @param {object} app
 * @param {(domain: object) => void} put
 */
export function meshForm(app, put) {
  const said = element("p", { class: "hint", role: "status" });
  const fault = element("p", { class: "fault", role: "alert" });
  const file = element("input", { type: "file", accept: ".msh,.vtu,.su2,.cgns,.p3d,.xyz,.zip" });
  file.addEventListener("change", async () => {
    if (!file.files.length) return;
    fault.textContent = "";
    const [chosen] = file.files;
    try {
      const stored = await app.service.uploadMesh(chosen);
      said.textContent = `${chosen.name}: ${stored.shape[0]} points, ${stored.shape[1]} cells, sides ${(stored.sides ?? []).join(", ") || "without names"}.`;
      put({ kind: "mesh", file: stored.id });
    } catch (error) {
      fault.textContent = (error.problem?.errors ?? []).map(({ message }) => message).join("; ") || error.message;
    }
    file.value = "";
  });
  return element("div", {},
    element("p", { class: "hint" }, "A mesh of quadrilaterals: .msh of Gmsh, .vtu, .su2, Plot3D, or a zip of an OpenFOAM polyMesh. Its blocks are found."),
    field("Mesh file", file),
    said,
    fault,
    numberField(app, "Corner angle (degrees)", ["domain", "corner_angle"], { optional: true, min: 0, max: 180, placeholder: "usual", help: "Where the boundary turns by more than this, there is a corner." }));
}

// The description in a text, or what is wrong with it.
function descriptionIn(text) {
  if (!text.trim()) return { fault: "Paste a description." };
  try {
    const value = JSON.parse(text);
    if (!value || typeof value !== "object" || Array.isArray(value)) return { fault: "A description is an object." };
    const { kind: _, ...description } = value;
    return { description };
  } catch (error) {
    return { fault: `This is no JSON: ${error.message}` };
  }
}

function withoutRefine({ refine: _, ...rest }) {
  return rest;
}

// JSON with one entry a line, which is shorter than one value a line.
function textOf(description) {
  const parts = Object.entries(description).map(([name, value]) => {
    if (Array.isArray(value)) return `"${name}": [\n${value.map((one) => `  ${JSON.stringify(one)}`).join(",\n")}\n]`;
    if (value && typeof value === "object") {
      return `"${name}": {\n${Object.entries(value).map(([key, one]) => `  ${JSON.stringify(key)}: ${JSON.stringify(one)}`).join(",\n")}\n}`;
    }
    return `"${name}": ${JSON.stringify(value)}`;
  });
  return `{\n${parts.join(",\n")}\n}`;
}
