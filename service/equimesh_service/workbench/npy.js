// Arrays as files of the format npy, which NumPy reads.

// Every file of the format begins with these six bytes, and the version 1.0 after them.
const MAGIC = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0];
// Magic bytes, and two bytes for the length of the header.
const PRELUDE_BYTES = 10;
// NumPy aligns the numbers to this many bytes.
const ALIGNMENT = 64;

/**
 * The bytes of an npy file with a two-dimensional array of float32, in C order.
 *
 * @param {Float32Array} values rows * columns numbers, row by row
 * @param {number} rows the length of the first axis
 * @param {number} columns the length of the second axis
 * @returns {Blob} the file
 */
export function npyFile(values, rows, columns) {
  const text = `{'descr': '<f4', 'fortran_order': False, 'shape': (${rows}, ${columns}), }`;
  const padding = ALIGNMENT - ((PRELUDE_BYTES + text.length + 1) % ALIGNMENT);
  const header = new TextEncoder().encode(`${text}${" ".repeat(padding)}\n`);
  const length = Uint8Array.of(header.length & 0xff, header.length >> 8);
  const body = new DataView(new ArrayBuffer(4 * values.length));
  // A DataView writes little-endian on every machine.
  values.forEach((value, index) => body.setFloat32(4 * index, value, true));
  return new Blob([Uint8Array.from(MAGIC), length, header, body], { type: "application/x-npy" });
}
