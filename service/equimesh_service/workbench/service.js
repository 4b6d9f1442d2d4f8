// All requests to the service.  Addresses are relative to the page, so that it works under any path of a proxy.

import { readNpz, textOfBytes } from "./npz.js";

const KEY = "equimesh-key";
// A preview that finds no free worker is tried so often, after these milliseconds.
const MOST_TRIES = 20;
const BUSY = 500;
const JSON_TYPE = { "Content-Type": "application/json" };

/** An answer that is no success: the problem of the service, with `status`, `detail`, `remedy` and `errors`. */
export class ServiceError extends Error {
  constructor(problem) {
    super(problem.detail ?? problem.title ?? "The service does not answer.");
    this.problem = problem;
  }
}

/**
 * The service behind this page.  All methods throw a `ServiceError`; with a `signal` that is aborted they throw the
 * `AbortError` of fetch.
 *
 * @param {URL} [root] the address of the service
 */
export function createService(root = new URL("./", document.baseURI)) {
  const address = (path) => new URL(path, root);

  async function send(path, { headers = {}, ...options } = {}) {
    const key = readKey();
    const all = key ? { ...headers, Authorization: `Bearer ${key}` } : headers;
    let reply;
    try {
      reply = await fetch(address(path), { ...options, headers: all });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new ServiceError({ title: "No answer", detail: "The service does not answer.", status: 0 });
    }
    if (!reply.ok) throw new ServiceError(await problemOf(reply));
    return reply;
  }

  const json = async (path, options) => (await send(path, options)).json();
  const post = (document, signal) => ({
    method: "POST",
    headers: JSON_TYPE,
    body: JSON.stringify(document),
    signal,
  });

  return {
    root,
    send,
    json,
    /** The API key of this tab; "" for none. */
    get key() {
      return readKey();
    },
    set key(value) {
      if (value) sessionStorage.setItem(KEY, value);
      else sessionStorage.removeItem(KEY);
    },
    /** A drawing of the mesh of a spec: `{arrays, document}`.  `samples` is a file, or null.  With
     * `isPatient` it is tried again while all workers are busy. */
    async preview(spec, { samples = null, frames = false, isPatient = false, signal } = {}) {
      const path = `v1/previews${frames ? "?frames=true" : ""}`;
      for (let tries = 1; ; tries += 1) {
        const options = samples ? { method: "POST", body: multipart(spec, samples), signal } : post(spec, signal);
        try {
          return drawingOf(await send(path, options));
        } catch (error) {
          const isBusy = error.problem?.type?.endsWith("/workers-busy");
          if (!isPatient || !isBusy || tries === MOST_TRIES || signal?.aborted) throw error;
        }
        await new Promise((resolve) => setTimeout(resolve, BUSY));
      }
    },
    /** The drawing of a finished mesh. */
    drawing: async (id, { signal } = {}) => drawingOf(await send(`v1/meshes/${id}/drawing`, { signal })),
    /** What the service says of an expression, with `names` and ranges. */
    check: (document, { signal } = {}) => json("v1/expressions/check", post(document, signal)),
    capabilities: () => json("v1/capabilities"),
    /** The body of `/readyz`, whether the service is ready or not; null where it does not answer. */
    async readiness() {
      try {
        return await (await fetch(address("readyz"))).json();
      } catch {
        return null;
      }
    },
    /** Request a mesh that the service keeps; `wait` in seconds. */
    requestMesh(spec, { samples = null, wait = 0, signal } = {}) {
      const options = samples ? { method: "POST", body: multipart(spec, samples), signal } : post(spec, signal);
      return json("v1/meshes", { ...options, headers: { ...options.headers, Prefer: `wait=${wait}` } });
    },
    mesh: (id, { wait = 0, signal } = {}) => json(`v1/meshes/${id}${wait ? `?wait=${wait}` : ""}`, { signal }),
    cancelMesh: (id) => json(`v1/meshes/${id}/cancel`, { method: "POST" }),
    deleteMesh: (id) => send(`v1/meshes/${id}`, { method: "DELETE" }),
    /** A file of the mesh as a Blob, in the format that is named. */
    file: async (id, format, { signal } = {}) =>
      (await send(`v1/meshes/${id}/file?format=${encodeURIComponent(format)}`, { signal })).blob(),
    /** Upload samples; the answer has their `id`.  `column` is the name of u among the columns of the file. */
    uploadSamples: (file, { column = null, signal } = {}) =>
      json(`v1/samples?${new URLSearchParams({ filename: file.name, ...(column === null ? {} : { column }) })}`, { method: "POST", body: file, signal }),
    /** Upload a mesh file that is to be a domain; the answer has its `id`. */
    uploadMesh: (file, { signal } = {}) =>
      json(`v1/samples?kind=mesh&filename=${encodeURIComponent(file.name)}`, { method: "POST", body: file, signal }),
    /** The events of a mesh with larger numbers than `after`, as `{event, data, number}`. */
    events: (id, { after = 0, signal } = {}) => eventsOf(send, id, after, signal),
  };
}

/** The events of a mesh, one after another, until it is finished or the connection ends. */
async function* eventsOf(send, id, after, signal) {
  const reply = await send(`v1/meshes/${id}/events?after=${after}`, { headers: { Accept: "text/event-stream" }, signal });
  if (!reply.body) return;
  const reader = reply.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value.replaceAll("\r\n", "\n");
    const blocks = text.split("\n\n");
    text = blocks.pop();
    for (const block of blocks) {
      const event = eventOf(block);
      if (event) yield event;
    }
  }
}

function eventOf(block) {
  const lines = block.split("\n");
  const of = (name) => lines.filter((line) => line.startsWith(`${name}:`)).map((line) => line.slice(name.length + 1).trim());
  const data = of("data").join("\n");
  return data ? { event: of("event")[0] ?? "message", data: JSON.parse(data), number: Number(of("id")[0]) } : null;
}

async function drawingOf(reply) {
  const { document, ...arrays } = readNpz(await reply.arrayBuffer());
  return { arrays, document: JSON.parse(textOfBytes(document)) };
}

async function problemOf(reply) {
  try {
    const problem = await reply.json();
    return { ...problem, status: reply.status };
  } catch {
    return { title: reply.statusText, detail: `The answer has the status ${reply.status}.`, status: reply.status };
  }
}

function multipart(spec, samples) {
  const form = new FormData();
  form.append("spec", new Blob([JSON.stringify(spec)], { type: "application/json" }));
  form.append("samples", samples, samples.name);
  return form;
}

function readKey() {
  return sessionStorage.getItem(KEY) ?? "";
}
