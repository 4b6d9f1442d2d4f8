// A density that is drawn by hand: positive values on a uniform grid over the box of the domain.

// Points along each side of the grid. The values travel in the spec, so that links and copies contain them.
const SIDE = 33;
// What is not painted has this density.
const BASE = 1;
// The density stays between these values: a spline through steeper samples would fall below 0.
const MAX_DENSITY = 100;
// How many strokes can be undone.
const MAX_UNDO = 50;
// Digits of a value in the spec; more would make links longer and change no picture.
const DIGITS = 3;

/** Values of a density and the strokes that made them. Places are shares of the box, from 0 to 1. */
export class Density {
  constructor(values = new Float64Array(SIDE * SIDE).fill(BASE)) {
    this.side = SIDE;
    this.values = values;
    this.before = [];
  }

  /** Whether nothing is painted. */
  get isEmpty() {
    return this.values.every((value) => value === BASE);
  }

  /** The largest value. */
  get largest() {
    return this.values.reduce((most, value) => Math.max(most, value), BASE);
  }

  /** Remember the values, so that `undo` comes back to them. */
  beginStroke() {
    this.before.push(this.values.slice());
    if (this.before.length > MAX_UNDO) this.before.shift();
  }

  /**
   * Paint one dab: a bell of the radius around a place.
   *
   * @param {{s: number, t: number}} place shares of the box along x and y
   * @param {{radius: number, strength: number, isErasing: boolean}} brush the radius as a share of the box; the density
   *   that is added in the middle
   */
  dab({ s, t }, { radius, strength, isErasing }) {
    for (let i = 0; i < SIDE; i += 1) {
      for (let j = 0; j < SIDE; j += 1) {
        const distance = ((i / (SIDE - 1) - s) ** 2 + (j / (SIDE - 1) - t) ** 2) / radius ** 2;
        const share = Math.exp(-2 * distance);
        const at = i * SIDE + j;
        const wanted = isErasing ? BASE + (this.values[at] - BASE) * (1 - share) : this.values[at] + strength * share;
        // Values that differ from the base by less than this are not seen.
        this.values[at] = wanted - BASE < 0.01 ? BASE : Math.min(wanted, MAX_DENSITY);
      }
    }
  }

  /** Take the last stroke back; whether there was one. */
  undo() {
    if (!this.before.length) return false;
    this.values = this.before.pop();
    return true;
  }

  /** Remove everything that is painted; it can be undone. */
  clear() {
    this.beginStroke();
    this.values = new Float64Array(SIDE * SIDE).fill(BASE);
  }

  /**
   * The density as samples of a spec.
   *
   * @param {{x: number[], y: number[]}} box first and last x and y of the domain
   * @returns {{grid: {x: number[], y: number[], values: number[][]}}} a source of the spec
   */
  source(box) {
    const axis = ([first, last]) =>
      Array.from({ length: SIDE }, (_, k) => (k === SIDE - 1 ? last : first + (k * (last - first)) / (SIDE - 1)));
    const values = Array.from({ length: SIDE }, (_, i) =>
      Array.from(this.values.subarray(i * SIDE, (i + 1) * SIDE), (value) => Number(value.toPrecision(DIGITS))),
    );
    return { grid: { x: axis(box.x), y: axis(box.y), values } };
  }

  /**
   * The density that a source of a spec describes, or null where it is not one of `source`.
   *
   * @param {any} source rho of a spec
   * @returns {Density | null}
   */
  static of(source) {
    const values = source?.grid?.values;
    if (!Array.isArray(values) || values.length !== SIDE || !values.every((row) => row.length === SIDE)) return null;
    const flat = Float64Array.from(values.flat());
    return flat.every((value) => value >= BASE && value <= MAX_DENSITY) ? new Density(flat) : null;
  }
}
