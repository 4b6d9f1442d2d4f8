// Where one looks: a point of the domain in the middle of a pane, and pixels for each unit of length.

// The smallest and largest magnification, relative to the whole domain.
const SMALLEST = 1;
const LARGEST = 5000;
// The share of a pane that the whole domain fills.
const FILL = 0.94;

/**
 * A camera that first shows the whole box of a domain.
 *
 * Points of a pane are in pixels from its top left corner; those of the domain are (x, y), with y upwards.
 */
export function createCamera() {
  let box = [0, 0, 1, 1];
  let pane = { width: 1, height: 1 };
  let zoom = 1;
  let centre = [0.5, 0.5];

  const whole = () => FILL * Math.min(pane.width / (box[2] - box[0]), pane.height / (box[3] - box[1]));
  const scale = () => zoom * whole();
  const toDomain = ([px, py]) => [
    centre[0] + (px - pane.width / 2) / scale(),
    centre[1] - (py - pane.height / 2) / scale(),
  ];

  function reset() {
    zoom = 1;
    centre = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
  }

  // The middle stays in the domain; without magnification all of it is seen.
  function hold() {
    zoom = Math.min(LARGEST, Math.max(SMALLEST, zoom));
    if (zoom === SMALLEST) reset();
    centre = [0, 1].map((k) => Math.min(box[k + 2], Math.max(box[k], centre[k])));
  }

  return {
    get zoom() {
      return zoom;
    },
    get scale() {
      return scale();
    },
    get centre() {
      return centre;
    },
    get pane() {
      return pane;
    },
    toDomain,
    toPane: ([x, y]) => [pane.width / 2 + (x - centre[0]) * scale(), pane.height / 2 - (y - centre[1]) * scale()],
    /** Another size of the panes, in pixels. */
    resize(width, height) {
      pane = { width: Math.max(1, width), height: Math.max(1, height) };
    },
    /** Another domain; the camera shows all of it when the box has changed. */
    setBox(next) {
      if (next.every((value, k) => value === box[k])) return;
      box = next;
      reset();
    },
    reset,
    /** Zoom by a factor; the point of the domain under `at` stays there. */
    zoomBy(factor, at = [pane.width / 2, pane.height / 2]) {
      const fixed = toDomain(at);
      zoom = Math.min(LARGEST, Math.max(SMALLEST, zoom * factor));
      const moved = toDomain(at);
      centre = [centre[0] + fixed[0] - moved[0], centre[1] + fixed[1] - moved[1]];
      hold();
    },
    /** Move by pixels. */
    pan(dx, dy) {
      if (zoom === SMALLEST) return;
      centre = [centre[0] - dx / scale(), centre[1] + dy / scale()];
      hold();
    },
  };
}

/** The smallest box [x, y, x, y] of all points of some arrays of coordinates. */
export function boxOf(...pairs) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of pairs) {
    for (let k = 0; k < x.length; k += 1) {
      if (x[k] < box[0]) box[0] = x[k];
      if (y[k] < box[1]) box[1] = y[k];
      if (x[k] > box[2]) box[2] = x[k];
      if (y[k] > box[3]) box[3] = y[k];
    }
  }
  return box[0] <= box[2] ? box : [0, 0, 1, 1];
}
