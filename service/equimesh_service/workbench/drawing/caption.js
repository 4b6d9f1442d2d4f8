// What stands around a saved picture: headline, captions of the panes, and the colour bar with its scale.

import { amount } from "../words.js";
import { COLOURS, colourAt, legendOf } from "../browser/colours.js";

// Pixels above and below the panes, and around everything.
const HEAD = 34;
const FOOT = 48;
const PAD = 12;
// The colour bar: its height, its longest length, and how many colours of it are given.
const BAR = 10;
const LONGEST = 360;
const STOPS = 17;
// The height of the captions in the stage, where they are written here, too.
const CAPTION = 30;

/**
 * The frame of a picture of the stage: `{left, width, height, shift, texts, bar}`.
 *
 * The picture begins `left` pixels from the edge of the stage, without the empty margins next to the domain, and the
 * stage begins `shift` pixels below its top.  `texts` are `{x, y, text, size, isBold, anchor}`; `bar` is
 * `{x, y, width, height, stops}` with `[share, colour]`, or null.
 *
 * @param {object} self the stage
 * @param {{headline: string, captions: [string, string][]}} words
 */
export function frameOf(self, { headline, captions }) {
  const [left, right] = edgesOf(self);
  const width = Math.max(right - left, 320);
  const shift = headline ? HEAD : PAD;
  const height = shift + self.stage.clientHeight + FOOT;
  const texts = headline ? [{ x: width / 2, y: 24, text: headline, size: 17, isBold: true, anchor: "middle" }] : [];
  self.panes.forEach((pane, k) => {
    const [name = "", more = ""] = captions[k] ?? [];
    texts.push({ x: pane.left - left + pane.width / 2, y: shift + pane.top - CAPTION + 20, text: name + more, size: 14, isBold: false, anchor: "middle" });
  });
  const legend = legendOfFrame(self, { width, top: shift + self.stage.clientHeight + 6 });
  return { left, width, height, shift, texts: [...texts, ...legend.texts], bar: legend.bar };
}

// The part of the stage with the domain; all of it where one has zoomed.
function edgesOf({ camera, panes, stage, mesh }) {
  if (camera.zoom > 1 || !mesh || !panes.length) return [0, stage.clientWidth];
  const xs = [mesh.x, mesh.uniformX].flatMap((x) => [least(x), -least(x.map((value) => -value))]);
  const at = (x) => camera.toPane([x, 0])[0];
  const lefts = panes.map((pane) => pane.left + at(Math.min(...xs)));
  const rights = panes.map((pane) => pane.left + at(Math.max(...xs)));
  return [Math.max(0, Math.min(...lefts) - PAD), Math.min(stage.clientWidth, Math.max(...rights) + PAD)];
}

const least = (values) => values.reduce((one, other) => Math.min(one, other), Infinity);

function legendOfFrame({ coloured, table }, { width, top }) {
  if (!coloured || !COLOURS[coloured.name].map) return { texts: [], bar: null };
  const { name, scale } = coloured;
  const length = Math.min(LONGEST, width - 2 * PAD);
  const x = (width - length) / 2;
  const stops = Array.from({ length: STOPS }, (_, k) => [k / (STOPS - 1), colourAt(table, k / (STOPS - 1))]);
  const isOneValue = scale.low === scale.high;
  const ends = [[0, scale.low, "start"], [0.5, scale.middle, "middle"], [1, scale.high, "end"]].slice(0, isOneValue ? 1 : 3);
  const texts = ends.map(([share, value, anchor]) => ({ x: x + share * length, y: top + BAR + 30, text: amount(value), size: 11, isBold: false, anchor }));
  texts.push({ x: width / 2, y: top + 11, text: legendOf(name), size: 12, isBold: false, anchor: "middle" });
  return { texts, bar: { x, y: top + 16, width: length, height: BAR, stops } };
}
