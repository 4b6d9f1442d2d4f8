// Arrays of an npz archive, as NumPy writes it without compression, in the browser.

const LOCAL = 0x04034b50;
const CENTRAL = 0x02014b50;
const END = 0x06054b50;
const TYPES = {
  "<f8": Float64Array,
  "<f4": Float32Array,
  "<i8": BigInt64Array,
  "<i4": Int32Array,
  "<u4": Uint32Array,
  "<u2": Uint16Array,
  "|u1": Uint8Array,
  "|i1": Int8Array,
  "|b1": Uint8Array,
};

/**
 * The arrays of an archive: for each name `{data, shape}`, with a typed array in C order.
 *
 * Throws an Error for an archive that is compressed, cut off, or holds other types than numbers.
 *
 * @param {ArrayBuffer} buffer
 * @returns {Object<string, {data: ArrayLike<number>, shape: number[]}>}
 */
export function readNpz(buffer) {
  const view = new DataView(buffer);
  const arrays = {};
  let place = directoryOf(view);
  while (place + 46 <= view.byteLength && view.getUint32(place, true) === CENTRAL) {
    const method = view.getUint16(place + 10, true);
    const nameLength = view.getUint16(place + 28, true);
    const extraLength = view.getUint16(place + 30, true);
    const name = textOf(buffer, place + 46, nameLength).replace(/\.npy$/, "");
    if (method !== 0) throw new Error(`'${name}' of the archive is compressed`);
    arrays[name] = arrayOf(buffer, contentOf(view, view.getUint32(place + 42, true)));
    place += 46 + nameLength + extraLength + view.getUint16(place + 32, true);
  }
  return arrays;
}

/** An array of bytes (uint8) as text in UTF-8. */
export function textOfBytes({ data }) {
  return new TextDecoder().decode(data);
}

// The central directory has the sizes even where the archive was streamed.
function directoryOf(view) {
  for (let place = view.byteLength - 22; place >= 0; place -= 1) {
    if (view.getUint32(place, true) === END) return view.getUint32(place + 16, true);
  }
  throw new Error("this is not an npz archive");
}

function contentOf(view, place) {
  if (view.getUint32(place, true) !== LOCAL) throw new Error("the npz archive is damaged");
  return place + 30 + view.getUint16(place + 26, true) + view.getUint16(place + 28, true);
}

function textOf(buffer, start, length) {
  return new TextDecoder("latin1").decode(new Uint8Array(buffer, start, length));
}

function arrayOf(buffer, start) {
  const view = new DataView(buffer, start);
  if (textOf(buffer, start + 1, 5) !== "NUMPY") throw new Error("a member of the archive is no array");
  const isLong = view.getUint8(6) > 1;
  const headerLength = isLong ? view.getUint32(8, true) : view.getUint16(8, true);
  const headerStart = isLong ? 12 : 10;
  const header = textOf(buffer, start + headerStart, headerLength);
  const descr = /'descr':\s*'([^']+)'/.exec(header)?.[1];
  const shape = (/'shape':\s*\(([^)]*)\)/.exec(header)?.[1] ?? "").match(/\d+/g)?.map(Number) ?? [];
  const Type = TYPES[descr];
  if (!Type) throw new Error(`arrays of type ${descr} are not read here`);
  if (/'fortran_order':\s*True/.test(header) && shape.length > 1) throw new Error("arrays in Fortran order are not read");
  const count = shape.reduce((product, size) => product * size, 1);
  const first = start + headerStart + headerLength;
  // A typed array must begin at a multiple of its item size, which a member of an archive need not.
  const data = new Type(buffer.slice(first, first + count * Type.BYTES_PER_ELEMENT));
  return { data, shape };
}
