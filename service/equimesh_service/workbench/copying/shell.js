// Words of a command for a POSIX shell.

// Nothing in a word of these characters means anything to a shell.
const BARE = /^[A-Za-z0-9_@%+=:,./-]+$/;

/**
 * A word as a shell reads it back to the same text: in single quotes where it needs them.
 *
 * @param {string|number} word
 */
export function quoted(word) {
  const text = String(word);
  return BARE.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

/**
 * A command of several lines, each of them but the last with a backslash at its end.
 *
 * @param {string[]} lines words that are quoted already
 */
export function command(lines) {
  return lines.join(" \\\n  ");
}
