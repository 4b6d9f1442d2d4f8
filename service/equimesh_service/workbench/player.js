// A control that moves through steps: play and pause, one step back or forward, and a slider.

import { element, select } from "./dom.js";

// The speeds that a visitor can choose, as factors.
const SPEEDS = [1, 4, 16];
// A slower machine skips steps; it does not play more slowly than this many frames a second.
const LONGEST_PAUSE = 0.25;

/** Whether the visitor asks for little motion: then steps follow each other without a smooth way between them. */
export function wantsLittleMotion() {
  return window.matchMedia("(prefers-reduced-motion: reduce)").matches;
}

/**
 * A player. Its position is a number from 0 to the last step; while it plays, also between two steps.
 *
 * `setSteps(last, position)` sets the number of the last step, and the position without a call of `onMove`.
 *
 * @param {object} options
 * @param {string} options.name what is played, in the labels: "iteration"
 * @param {number} options.stepsPerSecond the speed; a third of it where the visitor asks for little motion
 * @param {(step: number) => string} options.describe a step in words, for the slider
 * @param {(position: number, isPlaying: boolean) => void} options.onMove called after each change of the position
 * @param {() => number} [options.limit] the last position that it may play to now; it waits there
 * @returns {{element: HTMLElement, setSteps: (last: number, position?: number) => void, moveTo: (position: number) => void,
 *   pause: () => void, play: () => void, readonly position: number, readonly isPlaying: boolean}}
 */
export function createPlayer({ name, stepsPerSecond, describe, onMove, limit = () => Infinity }) {
  const player = { position: 0, last: 0, isPlaying: false };
  const play = element("button", { type: "button", class: "player-play" }, "Play");
  const back = element("button", { type: "button", "aria-label": `One step back (${name})` }, "−1");
  const forward = element("button", { type: "button", "aria-label": `One step forward (${name})` }, "+1");
  const slider = element("input", { type: "range", min: "0", max: "0", step: "1", value: "0", "aria-label": `Step of the ${name}` });
  let factor = SPEEDS[0];
  const speeds = select(SPEEDS.map((value) => ({ value: String(value), text: `${value} ×` })), String(factor), (value) => (factor = Number(value)));
  speeds.setAttribute("aria-label", `Speed of the ${name}`);
  let frame = 0;

  function show() {
    const step = Math.round(player.position);
    slider.value = String(step);
    slider.setAttribute("aria-valuetext", describe(step));
    play.textContent = player.isPlaying ? "Pause" : "Play";
    play.setAttribute("aria-label", `${player.isPlaying ? "Pause" : "Play"} the ${name}`);
    back.disabled = step <= 0;
    forward.disabled = step >= player.last;
  }

  function moveTo(position) {
    player.position = Math.min(Math.max(position, 0), player.last);
    show();
    onMove(player.position, player.isPlaying);
  }

  function pause() {
    cancelAnimationFrame(frame);
    if (!player.isPlaying) return;
    player.isPlaying = false;
    moveTo(Math.round(player.position));
  }

  function run() {
    const isStill = wantsLittleMotion();
    const slowness = isStill ? 3 : 1;
    let [before, exact] = [null, player.position];
    const tick = (now) => {
      before ??= now;
      exact = Math.min(exact + ((factor * stepsPerSecond) / slowness) * Math.min((now - before) / 1000, LONGEST_PAUSE), Math.max(exact, limit()));
      before = now;
      if (exact >= player.last) {
        player.position = player.last;
        pause();
        return;
      }
      moveTo(isStill ? Math.floor(exact) : exact);
      if (player.isPlaying) frame = requestAnimationFrame(tick);
    };
    frame = requestAnimationFrame(tick);
  }

  function begin() {
    player.isPlaying = true;
    if (player.position >= player.last) player.position = 0;
    moveTo(player.position);
    run();
  }

  play.addEventListener("click", () => (player.isPlaying ? pause() : begin()));
  const step = (by) => () => {
    pause();
    moveTo(Math.round(player.position) + by);
  };
  back.addEventListener("click", step(-1));
  forward.addEventListener("click", step(1));
  slider.addEventListener("input", () => {
    const wanted = Number(slider.value); // the pause puts the slider back to where the player is
    pause();
    moveTo(wanted);
  });

  return {
    element: element("div", { class: "player", role: "group", "aria-label": `Play the ${name}` }, play, back, forward, speeds, slider),
    setSteps(last, position = player.position) {
      player.last = last;
      slider.max = String(last);
      player.position = Math.min(position, last);
      show();
    },
    moveTo,
    pause,
    play: begin,
    get position() {
      return player.position;
    },
    get isPlaying() {
      return player.isPlaying;
    },
  };
}
