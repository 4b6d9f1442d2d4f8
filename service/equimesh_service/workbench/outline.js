// A drawing of the four sides of a domain, with points that are moved by pointer or by keys.

import { element } from "./dom.js";
import { SIDES, curvesOf, edgesOf, hasBlocks, sidesOf } from "./sides.js";

// The drawing in its own units, and the room around the domain.
const WIDTH = 320;
const HEIGHT = 220;
const MARGIN = 26;
// The share of the domain's size by which an arrow key moves a point; with Shift a tenth of it.
const STEP = 0.02;
const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
// The most points of a side that get a handle.
const MOST_HANDLES = 40;

/**
 * A drawing of the domain of a spec.
 *
 * @param {(side: string, k: number, point: [number, number]) => void} onMove called when a point of a side was moved
 */
export function createOutline(onMove) {
  const lines = element("g");
  const handles = element("g");
  const drawing = element("svg", { class: "outline", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "group", "aria-label": "The sides of the domain" }, lines, handles);
  let domain = {};
  let frame = frameOf([]);
  let dragged = null;

  function show(next) {
    domain = next ?? {};
    drawing.toggleAttribute("hidden", domain.kind === "mesh");
    if (hasBlocks(domain)) {
      showEdges(edgesOf(domain));
      return;
    }
    const sides = sidesOf(domain);
    // While a point is dragged the scale stays, so that the point stays under the pointer.
    if (!dragged) frame = frameOf(Object.values(sides).flat());
    lines.replaceChildren(...SIDES.flatMap((name) => sideOf(name, sides[name], frame)));
    showHandles();
  }

  function showEdges(edges) {
    frame = frameOf(edges.flat());
    lines.replaceChildren(...edges.map((points) => lineOf("side", points, frame)));
    handles.replaceChildren();
  }

  function showHandles() {
    const wanted = handlesOf(domain);
    const made = [...handles.children];
    if (made.map((one) => one.dataset.place).join() !== wanted.map(({ side, k }) => `${side}-${k}`).join()) {
      handles.replaceChildren(...wanted.map(handleOf));
    }
    [...handles.children].forEach((one, index) => {
      const { side, k, point } = wanted[index];
      const [x, y] = frame.to(point);
      one.setAttribute("cx", x);
      one.setAttribute("cy", y);
      one.setAttribute("aria-label", `${side}, point ${k + 1}: ${point.map(short).join(", ")}`);
    });
  }

  function handleOf({ side, k }) {
    const place = () => curvesOf(domain)[side].points[k];
    const circle = element("circle", { r: 7, tabindex: 0, role: "button", class: "handle", "data-place": `${side}-${k}` });
    circle.addEventListener("keydown", (event) => {
      const direction = DIRECTIONS[event.key];
      if (!direction) return;
      event.preventDefault();
      const step = frame.size * STEP * (event.shiftKey ? 0.1 : 1);
      onMove(side, k, place().map((value, axis) => rounded(value + direction[axis] * step, frame.size)));
    });
    circle.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      circle.focus();
      circle.setPointerCapture(event.pointerId);
      dragged = circle;
    });
    circle.addEventListener("pointermove", (event) => {
      if (dragged !== circle) return;
      const box = drawing.getBoundingClientRect();
      const at = [((event.clientX - box.left) / box.width) * WIDTH, ((event.clientY - box.top) / box.height) * HEIGHT];
      onMove(side, k, frame.from(at).map((value) => rounded(value, frame.size)));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      circle.addEventListener(end, () => {
        dragged = null;
        show(domain);
      });
    }
    return circle;
  }

  return { element: drawing, show };
}

// The line of a side with its name next to the middle; nothing for a side that cannot be read.
function sideOf(name, points, frame) {
  if (!points.length) return [];
  const placed = points.map(frame.to);
  const [x, y] = middleOf(placed);
  const [dx, dy] = { bottom: [0, 19], top: [0, -11], left: [-10, 4], right: [10, 4] }[name];
  const anchor = { left: "end", right: "start" }[name] ?? "middle";
  return [
    lineOf(`side ${name}`, points, frame),
    element("text", { x: x + dx, y: y + dy, "text-anchor": anchor }, name), // with a halo, as it may be on a line
  ];
}

function lineOf(name, points, frame) {
  return element("polyline", { class: name, points: points.map((point) => frame.to(point).map((value) => value.toFixed(1)).join(",")).join(" ") });
}

function middleOf(points) {
  const k = (points.length - 1) / 2;
  const [a, b] = [points[Math.floor(k)], points[Math.ceil(k)]];
  return [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
}

// The points of sides that are given by points; a corner has one handle for both of its sides.
function handlesOf(domain) {
  if (domain.kind !== "quadrilateral") return [];
  const seen = new Set();
  return SIDES.flatMap((side) => (domain[side]?.points ?? []).slice(0, MOST_HANDLES).map((point, k) => ({ side, k, point })))
    .filter(({ point }) => {
      const place = point.join();
      return point.length === 2 && point.every(Number.isFinite) && !seen.has(place) && seen.add(place);
    });
}

// From the plane to the drawing and back; both axes have the same scale.
function frameOf(points) {
  const ends = [0, 1].map((axis) => points.map((point) => point[axis]));
  const [x0, x1, y0, y1] = points.length ? [Math.min(...ends[0]), Math.max(...ends[0]), Math.min(...ends[1]), Math.max(...ends[1])] : [0, 1, 0, 1];
  const scale = Math.min((WIDTH - 2.6 * MARGIN) / (x1 - x0 || 1), (HEIGHT - 2 * MARGIN) / (y1 - y0 || 1));
  const [cx, cy] = [(x0 + x1) / 2, (y0 + y1) / 2];
  return {
    size: Math.max(x1 - x0, y1 - y0) || 1,
    to: ([x, y]) => [WIDTH / 2 + (x - cx) * scale, HEIGHT / 2 - (y - cy) * scale],
    from: ([x, y]) => [cx + (x - WIDTH / 2) / scale, cy - (y - HEIGHT / 2) / scale],
  };
}

// To a thousandth of the domain, so that coordinates can be read.
function rounded(value, size) {
  const digits = Math.max(0, Math.ceil(3 - Math.log10(size)));
  return Number(value.toFixed(Math.min(digits, 12)));
}

const short = (value) => Number(value.toPrecision(4));
