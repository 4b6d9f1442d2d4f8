// Numbers as people read them.

/**
 * A number with three digits, such as "0.0123", "12.3", "1.23e-6".
 *
 * @param {number|null|undefined} value
 */
export function amount(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "unknown";
  if (!Number.isFinite(value)) return value > 0 ? "infinite" : "minus infinite";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return value.toExponential(2).replace("e+", "e");
  return String(Number(value.toPrecision(3)));
}

/** A time in words, such as "42 ms" or "3.1 s". */
export function duration(milliseconds) {
  if (milliseconds < 1) return "less than 1 ms";
  return milliseconds < 1000 ? `${Math.round(milliseconds)} ms` : `${(milliseconds / 1000).toFixed(1)} s`;
}
