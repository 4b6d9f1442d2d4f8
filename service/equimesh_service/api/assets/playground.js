// The form of the front page: asks the service for a mesh, and shows it. Addresses follow that of this file.
const root = new URL("../../", document.currentScript.src);
const element = (id) => document.getElementById(id);
const form = element("playground");

function headers(more) {
  const key = form.key.value.trim();
  return key ? { ...more, Authorization: `Bearer ${key}` } : more;
}

function spec() {
  const points = Number(form.points.value);
  return {
    monitor: { kind: form.monitor.value, u: { expression: form.expression.value } },
    grid: { n_xi: points, n_eta: points },
    label: "playground",
  };
}

// What is wrong, and for an expression a caret under the place.
function complaint(problem) {
  const [first] = problem.errors || [];
  if (first && first.position && first.position.line === 1) {
    return [form.expression.value, " ".repeat(first.position.column - 1) + "^", first.message].join("\n");
  }
  return [problem.detail || problem.title, first ? "" : problem.remedy].filter(Boolean).join("\n");
}

async function answer(path, options = {}) {
  const reply = await fetch(new URL(path, root), { ...options, headers: headers(options.headers || {}) });
  if (!reply.ok) throw new Error(complaint(await reply.json()));
  return reply;
}

// Links of the service begin with the path that it is served under; here they are joined to its address.
const under = (link) => link.slice(link.indexOf("v1/"));

async function finished(mesh) {
  while (!mesh.finished_at) mesh = await (await answer(`${under(mesh.links.self)}?wait=10`)).json();
  if (mesh.status !== "succeeded") throw new Error(complaint(mesh.error || { detail: `The mesh was ${mesh.status}.` }));
  return mesh;
}

const number = (value) => (typeof value === "number" ? value.toFixed(2) : "not known");

async function show(mesh) {
  const format = mesh.grid.n_xi > 65 ? "png" : "svg";
  const picture = await (await answer(`${under(mesh.links.plot)}?kind=mesh&format=${format}`)).blob();
  URL.revokeObjectURL(element("picture").src);
  element("picture").src = URL.createObjectURL(picture);
  const gain = mesh.certificate.interpolation_gain || {};
  const told = {
    "interpolation error, uniform over this mesh": `${number(gain.l2)} in L2, ${number(gain.h1)} in H1`,
    "largest Q_eq": mesh.quality.q_eq.max.toFixed(3),
    "smallest Jacobian, 1 for a uniform mesh": mesh.quality.min_jacobian.toPrecision(3),
    "solved in": `${(1000 * mesh.timings.solve).toFixed(0)} ms`,
    status: mesh.certificate.status,
  };
  element("numbers").replaceChildren(...Object.entries(told).flatMap(([name, value]) => {
    const [term, text] = [document.createElement("dt"), document.createElement("dd")];
    [term.textContent, text.textContent] = [name, value];
    return [term, text];
  }));
  element("files").replaceChildren(...["vtu", "vtk", "vts", "xdmf", "msh", "medit", "su2", "foam", "npz"].map((format) => download(mesh, format)));
  element("result").hidden = false;
}

function download(mesh, format) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = format;
  button.addEventListener("click", () => attempt(async () => {
    const file = await (await answer(`${under(mesh.links.file)}?format=${format}`)).blob();
    const link = document.createElement("a");
    link.href = URL.createObjectURL(file);
    link.download = `${mesh.id}.${{ xdmf: "zip", medit: "mesh" }[format] || format}`;
    link.click();
    URL.revokeObjectURL(link.href);
  }));
  return button;
}

async function attempt(work) {
  element("complaint").textContent = "";
  form.go.disabled = true;
  try {
    await work();
  } catch (error) {
    element("complaint").textContent = error instanceof TypeError ? "The service does not answer." : error.message;
  } finally {
    form.go.disabled = false;
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(async () => {
    element("result").hidden = true;
    const options = { method: "POST", headers: { "Content-Type": "application/json", Prefer: "wait=10" } };
    const reply = await answer("v1/meshes", { ...options, body: JSON.stringify(spec()) });
    await show(await finished(await reply.json()));
  });
});

// An address such as /#u=tanh(30*(x-y))&n=49&monitor=curvature fills the form in, and sends it.
const asked = new URLSearchParams(location.hash.slice(1).replaceAll("+", "%2B"));
if (asked.has("u")) {
  form.expression.value = asked.get("u");
  if (asked.has("n")) form.points.value = asked.get("n");
  if (asked.has("monitor")) form.monitor.value = asked.get("monitor");
  form.requestSubmit();
}
