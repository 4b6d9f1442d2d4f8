// Zoom and pan of the stage: wheel, one or two fingers, keys.

// The factor of a key or a button, and of a wheel that moves by a pixel.
const STEP = 1.5;
const WHEEL = 1.0018;
// Pixels of a line, where a wheel counts lines.
const LINE = 18;

/**
 * Let wheel, pointers and keys move the camera of a stage.
 *
 * @param {object} self the stage
 */
export function followGestures(self) {
  const { stage, camera } = self;
  const fingers = new Map();
  const at = (event) => {
    const { left, top } = stage.getBoundingClientRect();
    return [event.clientX - left - stage.clientLeft, event.clientY - top - stage.clientTop];
  };
  const zoom = (factor, pixel) => {
    camera.zoomBy(factor, pixel && self.paneAt(pixel)[1]);
    self.move();
  };
  self.zoomBy = zoom;
  self.reset = () => {
    camera.reset();
    self.redraw();
  };

  stage.addEventListener(
    "wheel",
    (event) => {
      const pixels = event.deltaY * (event.deltaMode === 1 ? LINE : 1);
      // Where there is nothing to zoom out of, the wheel scrolls the page.
      if (pixels > 0 && camera.zoom <= 1) return;
      event.preventDefault();
      zoom(WHEEL ** -pixels, at(event));
    },
    { passive: false },
  );
  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || event.defaultPrevented) return;
    fingers.set(event.pointerId, at(event));
    if (event.pointerType === "mouse" || camera.zoom > 1 || fingers.size > 1) stage.setPointerCapture(event.pointerId);
    stage.classList.add("dragging");
  });
  stage.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = at(event);
    fingers.set(event.pointerId, now);
    if (fingers.size === 1) {
      camera.pan(now[0] - before[0], now[1] - before[1]);
      self.move();
    } else if (fingers.size === 2) {
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const apart = (place) => Math.max(1, Math.hypot(place[0] - other[0], place[1] - other[1]));
      zoom(apart(now) / apart(before), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    stage.addEventListener(name, (event) => {
      fingers.delete(event.pointerId);
      if (!fingers.size) stage.classList.remove("dragging");
    });
  }
  stage.addEventListener("dblclick", (event) => zoom(STEP * STEP, at(event)));
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "+" || event.key === "=") zoom(STEP);
    else if (event.key === "-") zoom(1 / STEP);
    else if (event.key === "0") self.reset();
    else return;
    event.preventDefault();
  });
}
