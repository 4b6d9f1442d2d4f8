// Pictures as samples: grey values on a uniform grid, with y upwards.

import { npyFile } from "./npy.js";

// The most samples along a side. More of them cost time in every preview and show nothing that a mesh resolves.
const MAX_SIDE = 256;
// The fewest samples along a side, which a bicubic spline needs.
const MIN_SIDE = 4;
// The share of red, green and blue in the brightness of a colour (ITU-R BT.709).
const RED = 0.2126;
const GREEN = 0.7152;
const BLUE = 0.0722;

/**
 * The grey values of a picture, as an npy file that the service reads as samples.
 *
 * @param {Blob} file a picture that the browser can read
 * @returns {Promise<{file: Blob, columns: number, rows: number, width: number, height: number}>} the samples, their
 *   numbers along x and y, and the pixels of the picture
 * @throws {Error} where the browser cannot read the picture
 */
export async function greySamples(file) {
  const picture = await decoded(file);
  const { width, height } = picture;
  const shrink = Math.min(1, MAX_SIDE / Math.max(width, height));
  const columns = Math.max(MIN_SIDE, Math.round(width * shrink));
  const rows = Math.max(MIN_SIDE, Math.round(height * shrink));
  const canvas = new OffscreenCanvas(columns, rows);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  // What is transparent is shown on white, as on paper.
  context.fillStyle = "white";
  context.fillRect(0, 0, columns, rows);
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, 0, 0, columns, rows);
  picture.close();
  const values = greyValues(context.getImageData(0, 0, columns, rows).data, columns, rows);
  return { file: npyFile(values, columns, rows), columns, rows, width, height };
}

/**
 * Brightness from 0 to 1, first index along x, second index along y upwards.
 *
 * @param {Uint8ClampedArray} pixels red, green, blue and opacity, row by row from the top
 * @param {number} columns pixels of a row
 * @param {number} rows the number of rows
 * @returns {Float32Array} columns * rows values
 */
export function greyValues(pixels, columns, rows) {
  const values = new Float32Array(columns * rows);
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      const at = 4 * (row * columns + column);
      const light = RED * pixels[at] + GREEN * pixels[at + 1] + BLUE * pixels[at + 2];
      values[column * rows + (rows - 1 - row)] = light / 255;
    }
  }
  return values;
}

async function decoded(file) {
  try {
    return await createImageBitmap(file);
  } catch {
    throw new Error("The browser cannot read this picture. Save it as PNG or JPEG.");
  }
}
