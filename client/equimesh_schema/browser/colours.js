// Colour maps that people with a colour-blindness can read, and the scales that turn values into places on them.

// Seventeen equally spaced colours of each map of matplotlib.
const MAPS = {
  viridis: "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 fde725",
  magma: "000004 0a0822 1d1147 36106b 51127c 6a1c81 832681 9c2e7f b73779 d0416f e75263 f56b5c fc8961 fea772 fec488 fde2a3 fcfdbf",
  PuOr: "2d004b 451871 5f3a91 7b6aa8 9990bf b7b1d5 cfcfe5 e4e5f0 f7f7f6 fce8cd fed59f fdbc6b ee9b39 d97b12 bd6109 9e4c07 7f3b08",
};
// The colours of subdomains, after Okabe and Ito; they repeat.
const SUBDOMAINS = "0072b2 e69f00 009e73 cc79a7 56b4e9 d55e00 f0e442 8c8c8c".split(" ").map(rgbOf);
const STEPS = 256;
// A logarithmic scale shows this many decades below the largest value.
const DECADES = 3;
// The share of the map of errors that is used: its darkest colours hide the lines.
const LEAST_DARK = 0.16;
// On a dark page its darkest ones hide the lines as well.
const LEAST_BRIGHT = 0.27;

/** What a mesh can be coloured by: the arrays that it needs, in words, and how values become colours. */
export const COLOURS = {
  error: { text: "interpolation error", map: "magma", scale: "root", unit: "interpolation error of u in a cell" },
  u: { text: "u", map: "viridis", scale: "linear", unit: "u" },
  q_eq: { text: "share (Q_eq)", map: "PuOr", scale: "balanced", unit: "share of a cell (Q_eq), 1 is its equal share" },
  size: { text: "cell size", map: "viridis", scale: "log", unit: "side of a square of the same area" },
  subdomain: { text: "subdomain", map: null, scale: "classes", unit: "subdomain" },
  none: { text: "lines only", map: null, scale: "none", unit: "" },
};

// The scales in words.
const SCALES = { root: "square-root scale", log: "logarithmic scale", balanced: "logarithmic scale" };

/** What a legend says: the quantity, and the scale where it is not linear. */
export function legendOf(name) {
  const { unit, scale } = COLOURS[name];
  return SCALES[scale] ? `${unit} (${SCALES[scale]})` : unit;
}

/**
 * A scale for all values, those of both meshes: `{low, high, scale, place(value)}`, with `place` from 0 to 1.
 *
 * "log" shows three decades below the largest value, "balanced" is logarithmic about 1, "linear" goes from the smallest
 * to the largest value, "root" from 0 to the largest value by square roots, so that small values are told apart.
 *
 * @param {string} scale
 * @param {ArrayLike<number>[]} arrays
 */
export function scaleOf(scale, arrays) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of arrays) {
    for (let k = 0; k < values.length; k += 1) {
      if (values[k] < low) low = values[k];
      if (values[k] > high) high = values[k];
    }
  }
  if (!(low <= high)) [low, high] = [0, 1];
  if (scale === "log") {
    if (!(high > 0)) return linear(0, 1);
    low = Math.max(low, high * 10 ** -DECADES);
    return logarithmic(Math.min(low, high / 2), high);
  }
  if (scale === "root") {
    const place = (value) => Math.sqrt(Math.max(0, value) / (high > 0 ? high : 1));
    return { low: 0, high, middle: high / 4, place };
  }
  if (scale === "balanced") {
    const far = Math.min(100, Math.max(1.5, high, low > 0 ? 1 / low : 1));
    return logarithmic(1 / far, far);
  }
  return linear(low, high);
}

function linear(low, high) {
  const span = high - low || 1;
  return { low, high, middle: (low + high) / 2, place: (value) => (value - low) / span };
}

function logarithmic(low, high) {
  const [first, span] = [Math.log(low), Math.log(high / low) || 1];
  const place = (value) => (value > 0 ? Math.max(0, (Math.log(value) - first) / span) : 0);
  return { low, high, middle: Math.sqrt(low * high), place };
}

/**
 * The colours of a map from low to high as bytes (red, green, blue, 255), 256 of them.
 *
 * @param {string} name one of the keys of `COLOURS`
 * @param {boolean} isDark a dark page: errors are bright on it, and dark on a light one
 */
export function tableOf(name, isDark) {
  const table = new Uint8Array(4 * STEPS);
  const { map } = COLOURS[name];
  const stops = map ? MAPS[map].split(" ").map(rgbOf) : null;
  for (let k = 0; k < STEPS; k += 1) {
    const place = k / (STEPS - 1);
    const colour = stops ? between(stops, onMap(map, isDark, place)) : classColour(name, k, isDark);
    table.set([...colour, 255], 4 * k);
  }
  return table;
}

// Where a place of the scale is on its map: errors are dark on a light page, and bright on a dark one.
function onMap(map, isDark, place) {
  if (map !== "magma") return place;
  return isDark ? LEAST_BRIGHT + (1 - LEAST_BRIGHT) * place : 1 - (1 - LEAST_DARK) * place;
}

/** The place of a class (the number of a subdomain) on the table of its colours. */
export function placeOfClass(number) {
  return (number % SUBDOMAINS.length) / (STEPS - 1);
}

/** A colour of a table at a place from 0 to 1, such as "rgb(1, 2, 3)". */
export function colourAt(table, place) {
  const k = 4 * Math.round(Math.min(1, Math.max(0, place)) * (STEPS - 1));
  return `rgb(${table[k]}, ${table[k + 1]}, ${table[k + 2]})`;
}

function classColour(name, k, isDark) {
  if (name === "subdomain") return SUBDOMAINS[k % SUBDOMAINS.length];
  return isDark ? [26, 32, 40] : [255, 255, 255];
}

function between(stops, place) {
  const at = place * (stops.length - 1);
  const first = Math.min(stops.length - 2, Math.floor(at));
  const share = at - first;
  return stops[first].map((value, c) => Math.round((1 - share) * value + share * stops[first + 1][c]));
}

function rgbOf(hex) {
  return [0, 2, 4].map((place) => Number.parseInt(hex.slice(place, place + 2), 16));
}
