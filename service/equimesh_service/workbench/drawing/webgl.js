// The renderer with WebGL2: nodes are uploaded once, and the vertex shader moves them between both meshes.

import { createTiles } from "./tiles.js";

// The values of nodes are a texture of rows of this many.
const ROW = 1024;
// While something moves, the most cells of a pane: of a processor that draws, and of a graphics card.
const MOST_BY_PROCESSOR = 1200;
const MOST_BY_CARD = 150_000;
// Names of renderers that draw with the processor.
const PROCESSORS = /swiftshader|llvmpipe|softpipe|software|basic render/i;

const VERTEX = `#version 300 es
layout(location = 0) in vec2 adapted;
layout(location = 1) in vec2 uniformly;
layout(location = 2) in float place;
layout(location = 3) in float uniformPlace;
uniform float blend;
uniform vec2 scale;
uniform vec2 centre;
uniform int columns;
uniform int first;
out float smoothPlace;
out vec2 index;
void main() {
  vec2 node = mix(uniformly, adapted, blend);
  smoothPlace = mix(uniformPlace, place, blend);
  int number = gl_VertexID - first;
  index = vec2(number / columns, number % columns);
  gl_Position = vec4((node - centre) * scale, 0.0, 1.0);
}`;

// Lines are where an index is whole: one pixel wide at any magnification, and faint where cells are small.
const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
in float smoothPlace;
in vec2 index;
uniform sampler2D table;
uniform sampler2D values;
uniform ivec2 shape;
uniform int first;
uniform float blend;
uniform bool isFlat;
uniform bool hasLines;
uniform float width;
uniform vec3 ink;
out vec4 colour;
// The value of the cell in which an index is: it stands at its first node.
float flatPlace() {
  ivec2 cell = clamp(ivec2(index), ivec2(0), shape - 2);
  int k = first + cell.x * shape.y + cell.y;
  vec2 both = texelFetch(values, ivec2(k % ${ROW}, k / ${ROW}), 0).rg;
  return mix(both.x, both.y, blend);
}
void main() {
  float place = clamp(isFlat ? flatPlace() : smoothPlace, 0.0, 1.0);
  vec3 fill = texture(table, vec2((place * 255.0 + 0.5) / 256.0, 0.5)).rgb;
  if (hasLines) {
    vec2 pixel = max(fwidth(index), 1e-6);
    vec2 away = abs(fract(index - 0.5) - 0.5) / pixel;
    vec2 cover = clamp(0.5 * width + 0.5 - away, 0.0, 1.0);
    // Next to a line of every second pixel nothing else could be seen.
    vec2 faint = clamp(1.15 - 2.2 * pixel * width, 0.12, 1.0);
    vec2 line = cover * faint;
    float light = dot(fill, vec3(0.299, 0.587, 0.114));
    vec3 pen = ink.r < 0.0 ? (light > 0.5 ? vec3(0.0) : vec3(1.0)) : ink;
    fill = mix(fill, pen, 0.55 * max(line.x, line.y));
  }
  colour = vec4(fill, 1.0);
}`;

/**
 * See `createRenderer`.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {WebGL2RenderingContext} gl
 */
export function createWebglRenderer(canvas, gl) {
  const most = isByProcessor(gl) ? MOST_BY_PROCESSOR : MOST_BY_CARD;
  let parts = build(gl);
  let mesh = null;
  let tiles = null;
  let colours = null;
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    parts = build(gl);
    if (mesh) setNodes(mesh);
    if (colours) setColours(colours);
  });

  function setNodes(next) {
    const shape = next.blocks.map((block) => block.shape.join(" ")).join();
    mesh = next;
    tiles = createTiles(next, parts.shape === shape ? tiles.triangles : undefined);
    upload(gl, parts.buffers.adapted, interleaved(next.x, next.y));
    upload(gl, parts.buffers.uniformly, interleaved(next.uniformX, next.uniformY));
    if (parts.shape === shape) return;
    parts.shape = shape;
    gl.bindVertexArray(parts.vertices);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, parts.buffers.cells);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, tiles.triangles.indices, gl.STATIC_DRAW);
  }

  function setColours(next) {
    colours = next;
    upload(gl, parts.buffers.place, next.places);
    upload(gl, parts.buffers.uniformPlace, next.uniformPlaces);
    const both = interleaved(next.uniformPlaces, next.places);
    const rows = Math.ceil(both.length / 2 / ROW);
    const full = new Float32Array(2 * ROW * rows);
    full.set(both);
    bind(gl, 1, parts.values);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG32F, ROW, rows, 0, gl.RG, gl.FLOAT, full);
    bind(gl, 0, parts.table);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, next.table);
  }

  function draw(panes, camera, { ratio, lines, ink, paper, isMoving = false }) {
    const drawn = { stride: 1, triangles: 0 };
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!mesh || !colours) return drawn;
    const { places, program, vertices } = parts;
    gl.useProgram(program);
    gl.bindVertexArray(vertices);
    gl.uniform1i(places.values, 1);
    gl.uniform1i(places.isFlat, Number(colours.isFlat));
    gl.uniform1i(places.hasLines, Number(lines));
    gl.uniform1f(places.width, Math.max(1, ratio));
    gl.uniform3fv(places.ink, ink ?? [-1, -1, -1]);
    gl.uniform2f(places.centre, ...camera.centre);
    gl.enable(gl.SCISSOR_TEST);
    for (const pane of panes) {
      const [left, width, height] = [pane.left, pane.width, pane.height].map((value) => Math.round(value * ratio));
      const bottom = canvas.height - Math.round((pane.top + pane.height) * ratio);
      gl.viewport(left, bottom, width, height);
      gl.scissor(left, bottom, width, height);
      gl.uniform2f(places.scale, (2 * camera.scale) / pane.width, (2 * camera.scale) / pane.height);
      gl.uniform1f(places.blend, pane.blend);
      const { stride, ranges } = tiles.choose(camera, pane, isMoving ? most : Infinity);
      for (const [number, first, count] of ranges) {
        enter(gl, places, mesh.blocks[number]);
        gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, Uint32Array.BYTES_PER_ELEMENT * first);
        drawn.triangles += count / 3;
      }
      drawn.stride = Math.max(drawn.stride, stride);
    }
    return drawn;
  }

  return { kind: "webgl2", setNodes, setColours, draw, finish: () => gl.finish() };
}

// The block whose triangles come next.
function enter(gl, places, { shape, node }) {
  gl.uniform1i(places.columns, shape[1]);
  gl.uniform2i(places.shape, ...shape);
  gl.uniform1i(places.first, node);
}

function interleaved(x, y) {
  const both = new Float32Array(2 * x.length);
  for (let k = 0; k < x.length; k += 1) {
    both[2 * k] = x[k];
    both[2 * k + 1] = y[k];
  }
  return both;
}

function isByProcessor(gl) {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return PROCESSORS.test(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}

function bind(gl, unit, texture) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
}

function upload(gl, buffer, values) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
}

function build(gl) {
  const program = gl.createProgram();
  for (const [type, source] of [
    [gl.VERTEX_SHADER, VERTEX],
    [gl.FRAGMENT_SHADER, FRAGMENT],
  ]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`the shaders were refused: ${gl.getProgramInfoLog(program)}`);
  }
  const vertices = gl.createVertexArray();
  gl.bindVertexArray(vertices);
  const buffers = { cells: gl.createBuffer() };
  [["adapted", 2], ["uniformly", 2], ["place", 1], ["uniformPlace", 1]].forEach(([name, size], location) => {
    buffers[name] = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, size, gl.FLOAT, false, 0, 0);
  });
  const names = ["blend", "scale", "centre", "columns", "first", "shape", "values", "isFlat", "hasLines", "width", "ink"];
  const places = Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)]));
  const [table, values] = [gl.createTexture(), gl.createTexture()];
  return { program, vertices, buffers, places, table, values, shape: "" };
}
