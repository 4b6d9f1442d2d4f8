// The meshes of a function at a sequence of times, fetched one after another and kept.

import { atTime } from "./sources.js";

/** The most meshes of a film. */
export const MOST_MESHES = 200;
// Arrays that change along a straight line between two meshes. Those of cells are shown as they are.
const NODAL = ["x", "y", "u", "uniform_u"];

/** The drawings of a spec at given times. `ready` of them, from the first one on, are here. */
export class Film {
  constructor(app) {
    this.app = app;
    this.forget();
  }

  /** Drop all drawings, and the request that is under way. */
  forget() {
    this.request?.abort();
    Object.assign(this, { drawings: [], times: [], request: null, recipe: "" });
  }

  /** How many drawings are here without a gap. */
  get ready() {
    return this.drawings.length;
  }

  /**
   * Take a spec and its times; drawings are kept where both are those of before.
   *
   * @param {object} spec
   * @param {object | null} samples those of the state
   * @param {number[]} times
   * @param {boolean} isQuick whether the spec is that of a quick look
   * @returns {boolean} whether both are those of before
   */
  take(spec, samples, times, isQuick) {
    const recipe = JSON.stringify([spec, times]);
    if (recipe === this.recipe && samples === this.samples) return true;
    this.forget();
    Object.assign(this, { spec, samples, times, isQuick, recipe });
    return false;
  }

  /**
   * Fetch all drawings that are not here, one after another, unless they are being fetched.
   *
   * @param {(error: Error) => void} onError called for an answer that is no drawing
   */
  async fetch(onError) {
    if (this.request || this.ready === this.times.length) return;
    const mine = (this.request = new AbortController());
    try {
      while (this.request === mine && this.ready < this.times.length) {
        const t = this.times[this.ready];
        const file = this.samples?.file ?? null;
        const options = { samples: file, isPatient: true, signal: mine.signal };
        const drawing = await this.app.service.preview(atTime(this.spec, t), options);
        if (this.request !== mine) return;
        if (!drawing.arrays.x) throw new Error(drawing.document.error?.detail ?? "There is no mesh at this t.");
        this.drawings.push({ ...this.shared(drawing), isQuick: this.isQuick, milliseconds: 1000 * (drawing.document.seconds?.solve ?? 0) });
      }
      if (this.request === mine) this.request = null;
    } catch (error) {
      if (this.request !== mine) return;
      this.request = null;
      if (error.name !== "AbortError") onError(error);
    }
  }

  // The uniform mesh is that of the first drawing, so that a film does not keep it for every time.
  shared(drawing) {
    const first = this.drawings[0];
    if (!first) return drawing;
    const { uniform_x, uniform_y } = first.arrays;
    return { ...drawing, arrays: { ...drawing.arrays, uniform_x, uniform_y } };
  }
}

/**
 * The drawing between two drawings of a film.
 *
 * @param {object} before
 * @param {object} after
 * @param {number} share 0 is `before`, 1 is `after`
 */
export function between(before, after, share) {
  if (before === after || share === 0) return before;
  const near = share < 0.5 ? before : after;
  const arrays = { ...near.arrays };
  for (const name of NODAL) {
    const [one, other] = [before.arrays[name], after.arrays[name]];
    if (!one || !other || one.data.length !== other.data.length) continue;
    arrays[name] = { shape: one.shape, data: one.data.map((value, k) => value + share * (other.data[k] - value)) };
  }
  return { ...near, arrays };
}
