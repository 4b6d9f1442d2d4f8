// Formulas in a browser: the language of expressions, from text to a program that evaluates u and its gradient.
//
// It accepts what the service accepts, and means the same by it; what can be read in two ways is refused.  Nothing is
// ever evaluated as JavaScript.

const PREFIX = /^(?:numpy|np|math)\.(?=[A-Za-z_])/;
const NUMBER = /^(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?/;
const WORD = /^[\p{L}_][\p{L}\p{Nd}_]*/u;
const OPERATOR = /^(?:\*\*|<=|>=|==|!=|[-+*/<>(),|^])/;
const RAISED = /^⁻?[⁰¹²³⁴⁵⁶⁷⁸⁹]+/;
const SPACE = /^[ \t\r\n\u00a0\u2000-\u200a\u202f\u205f]+/;
const DIGITS = "⁰¹²³⁴⁵⁶⁷⁸⁹";
const SAME_SIGNS = { "^": "**", "≤": "<=", "≥": ">=", "≠": "!=" };
for (const sign of "×·⋅∙∗") SAME_SIGNS[sign] = "*";
for (const sign of "÷∕⁄") SAME_SIGNS[sign] = "/";
for (const sign of "−–‐‑") SAME_SIGNS[sign] = "-";
const SAME_NAMES = { "π": "pi", ln: "log", fabs: "abs", absolute: "abs", maximum: "max", minimum: "min", sgn: "sign" };
for (const name of ["sin", "cos", "tan", "tan2", "sinh", "cosh", "tanh"]) SAME_NAMES[`arc${name}`] = `a${name}`;
const COMPARISONS = new Set(["<", "<=", ">", ">=", "==", "!="]);
// Behind the argument of a function without brackets.
const AFTER_ARGUMENT = new Set(["+", "-", ...COMPARISONS, "and", "or", ",", ")"]);
// Arguments where they are not one: the fewest, and the most.
const ARGUMENTS = { atan2: [2, 2], hypot: [2, 2], min: [2, Infinity], max: [2, Infinity], where: [3, 3] };
const MOST_CHARACTERS = 4096;
const MOST_OPERATIONS = 1000;
const MOST_DEPTH = 100;
const MOST_DIGITS = 40;
// Integer powers up to this one are products.
const MOST_MULTIPLIED = 16;

/**
 * A text that is no formula of the language: `message` is a sentence, `offset` its place in the text, and `unknown` the
 * name that could be a parameter, if that is what is wrong.
 */
export class FormulaError extends Error {
  constructor(message, offset = 0, unknown = "") {
    super(message);
    Object.assign(this, { offset, unknown });
  }
}

// From text to tokens.  Signs that people leave out are put in: `2x` becomes `2*x`, and `|x|` becomes `abs(x)`.

function tokenAt(text, offset, names) {
  const rest = text.slice(offset);
  const number = NUMBER.exec(rest);
  if (number) return { kind: "number", text: number[0], start: offset, end: offset + number[0].length };
  const before = PREFIX.exec(rest)?.[0].length ?? 0;
  let word = WORD.exec(rest.slice(before))?.[0];
  if (word) {
    // The letter pi is a word of its own.
    if (word.includes("π") && !names.has(word)) word = word[0] === "π" ? "π" : word.slice(0, word.indexOf("π"));
    const kind = ["and", "or", "not"].includes(word) ? "sign" : "name";
    const own = names.has(word) || Object.hasOwn(FUNCTIONS, word);
    const name = own ? word : Object.hasOwn(SAME_NAMES, word) ? SAME_NAMES[word] : word;
    return { kind, text: name, start: offset, end: offset + before + word.length };
  }
  const raised = RAISED.exec(rest);
  if (raised) {
    const digits = Array.from(raised[0], (sign) => (sign === "⁻" ? "-" : DIGITS.indexOf(sign))).join("");
    return { kind: "raised", text: digits, start: offset, end: offset + raised[0].length };
  }
  const operator = /^(?:\/\/|=>|=<)/.test(rest) ? null : OPERATOR.exec(rest);
  const sign = operator?.[0] ?? rest[0];
  if (!operator && !Object.hasOwn(SAME_SIGNS, sign)) throw new FormulaError(`'${sign}' does not belong in an expression: remove it`, offset);
  return { kind: "sign", text: SAME_SIGNS[sign] ?? sign, start: offset, end: offset + sign.length };
}

function scan(text, names) {
  const tokens = [];
  let offset = SPACE.exec(text)?.[0].length ?? 0;
  while (offset < text.length) {
    const token = tokenAt(text, offset, names);
    tokens.push(token);
    offset = token.end + (SPACE.exec(text.slice(token.end))?.[0].length ?? 0);
  }
  return tokens;
}

const isFunction = (token) => token?.kind === "name" && Object.hasOwn(FUNCTIONS, token.text);

/** The tokens of a text with every sign that it means. */
function spell(text, names) {
  const out = [];
  const groups = [{ isBar: false, unclear: null }];
  let isRaised = false; // the last token is the end of a raised number
  let open = null; // the function whose argument without brackets is the last token
  const last = () => out.at(-1);
  const typed = (token) => text.slice(token.start, token.end) || token.text;
  const refuse = (token, message) => { throw new FormulaError(message, token.start); };
  const wantsOperand = () => !last() || (last().kind === "sign" && last().text !== ")");
  const closesBar = (token) => token.text === "|" && groups.at(-1).isBar;
  const sign = (mark, start, end = start) => ({ kind: "sign", text: mark, start, end });
  const give = (token) => { out.push(token); isRaised = false; };

  function product(token) {
    const left = last();
    const group = groups.at(-1);
    if (token.kind === "number") refuse(token, `no operator between '${typed(left)}' and '${typed(token)}': write ${typed(left)}*${typed(token)} for a product`);
    if (text[left.start] === "|" && left.text === ")") refuse(token, "a product behind a bar needs its sign: write |...|*...");
    if (text.slice(left.end, token.start).includes("\n")) refuse(token, `no operator between '${typed(left)}' and '${typed(token)}' on the next line: write * for a product`);
    if (token.text === "(" && left.kind === "name" && left.text === "e") refuse(token, "e is a number: write e*(...) for a product, exp(...) for the exponential function");
    if (left.kind === "number" && left.end === token.start) {
      if (/^[jJ]$/.test(token.text) && !names.has(token.text)) refuse(left, "complex numbers are not part of the language");
      if (token.text === "e" && /^\s*[-+−–‐‑]/.test(text.slice(token.end))) refuse(token, `${typed(left)}e may be a number without its end: write ${typed(left)}*e for a product`);
    }
    if (group.unclear && (group.unclear.text === "/" || left.text !== ")") && (token.kind !== "name" || names.has(token.text) || isFunction(token))) {
      refuse(token, `'${text.slice(group.unclear.start, token.end)}' can be read in two ways: write brackets, or *`);
    }
    group.unclear = null;
    give(sign("*", left.end, token.start));
  }

  function plain(token) {
    const group = groups.at(-1);
    if (token.kind === "sign" && !wantsOperand()) {
      if (token.text === "**") {
        if (isRaised) refuse(token, "a power of a power needs brackets: write for instance (x**2)**3");
        if (!group.unclear && (last().kind === "number" || last().text === "e")) group.unclear = token;
      } else if (token.text !== "(" && token.text !== ")") group.unclear = token.text === "/" ? token : null;
    }
    if (token.text === "(") groups.push({ isBar: false, unclear: null });
    else if (token.text === ")") {
      requireNoBar(token);
      if (groups.length > 1) groups.pop();
    }
    give(token);
  }

  function requireNoBar(token) {
    if (groups.at(-1).isBar) refuse(token, "a '|' is never closed: add '|' behind an absolute value");
  }

  function bar(token) {
    if (!wantsOperand() && closesBar(token)) {
      groups.pop();
      give(sign(")", token.start, token.end));
      return;
    }
    if (!wantsOperand()) product(token);
    groups.push({ isBar: true, unclear: null });
    give({ kind: "name", text: "abs", start: token.start, end: token.start });
    give(sign("(", token.start, token.end));
  }

  function endArgument(token) {
    if (token && !AFTER_ARGUMENT.has(token.text) && !closesBar(token)) {
      refuse(token, `'${typed(token)}' may belong to ${open.text} or not: write the argument of ${open.text} in brackets`);
    }
    open = null;
    give(sign(")", last().end));
  }

  function afterFunction(name, token) {
    if (token.text === "(") return plain(token);
    if (token.kind === "raised" || token.text === "**") refuse(token, `a power of a function follows its argument: write ${name.text}(x)**2`);
    if (token.kind === "sign") refuse(name, `${name.text} is a function: write ${name.text}(...)`);
    if (isFunction(token) || ARGUMENTS[name.text]) refuse(token, `write ${name.text}(...), with its argument in brackets`);
    open = name;
    give(sign("(", name.end, token.start));
    give(token);
  }

  for (const token of scan(text, names)) {
    if (open) endArgument(token);
    if (isFunction(last())) afterFunction(last(), token);
    else if (token.text === "|") bar(token);
    else if (token.kind === "raised") {
      if (wantsOperand()) refuse(token, `something is missing before '${typed(token)}'`);
      plain(sign("**", token.start));
      if (token.text[0] === "-") give(sign("-", token.start));
      give({ kind: "number", text: token.text.replace("-", ""), start: token.start, end: token.end });
      isRaised = true;
      if (groups.at(-1).unclear?.start === token.start) groups.at(-1).unclear = null; // it ends where its digits end
    } else {
      if (!wantsOperand() && (token.kind !== "sign" || token.text === "(")) product(token);
      plain(token);
    }
  }
  if (open) endArgument(null);
  if (isFunction(last())) refuse(last(), `${last().text} is a function: write ${last().text}(...)`);
  if (groups.at(-1).isBar) throw new FormulaError("a '|' is never closed: add '|' behind an absolute value", text.length);
  return out;
}

// From tokens to operations `[name, ...numbers of operations]`; equal ones are made once.

/**
 * The operations of a text, the result last: `["number", value]`, `["name", name]`, or an operation with arguments.
 *
 * @param {string} text
 * @param {Set<string>} names those that may occur
 */
function parse(text, names) {
  if (text.length > MOST_CHARACTERS) throw new FormulaError(`the expression is longer than ${MOST_CHARACTERS} characters: simplify it`);
  const tokens = spell(text, names);
  const operations = [];
  const known = new Map();
  let at = 0;
  let depth = 0;
  const next = () => tokens[at];
  const isSign = (...signs) => next()?.kind === "sign" && signs.includes(next().text);
  const refuse = (message) => { throw new FormulaError(message, next()?.start ?? text.length); };

  function add(...operation) {
    const key = operation.join(" ");
    if (!known.has(key)) {
      if (operations.length >= MOST_OPERATIONS) refuse(`the expression has more than ${MOST_OPERATIONS} operations: simplify it`);
      known.set(key, operations.push(operation) - 1);
    }
    return known.get(key);
  }

  function deeper(read) {
    depth += 1;
    if (depth > 4 * MOST_DEPTH) refuse(`the expression is nested more than ${MOST_DEPTH} levels deep: simplify it`);
    try {
      return read();
    } finally {
      depth -= 1; // also where a condition in brackets turns out to be a quantity
    }
  }

  function chain(signs, read) {
    let left = read();
    while (isSign(...signs)) left = add(tokens[at++].text, left, read());
    return left;
  }

  const sum = () => deeper(() => chain(["+", "-"], () => chain(["*", "/"], signed)));

  function signed() {
    if (isSign("+")) return (at += 1), deeper(signed);
    if (isSign("-")) return (at += 1), add("negative", deeper(signed));
    const base = operand();
    return isSign("**") ? ((at += 1), add("**", base, deeper(signed))) : base;
  }

  function operand() {
    const token = next();
    if (!token) refuse("the expression ends where a number, a name or a bracket is missing");
    if (token.kind === "number") {
      if (token.text.length > MOST_DIGITS) refuse(`the number has more than ${MOST_DIGITS} characters: round it`);
      if (!Number.isFinite(Number(token.text))) refuse(`the number ${token.text} is too large`);
      if (/^0\d*[1-9]\d*$/.test(token.text)) refuse(`the number ${token.text} starts with 0`);
      at += 1;
      return add("number", Number(token.text));
    }
    if (token.kind === "name") return isFunction(token) ? call(token) : name(token);
    if (!isSign("(")) refuse(`a number, a name or a bracket is missing before '${token.text}'`);
    at += 1;
    const inside = sum();
    if (isSign(...COMPARISONS, "and", "or")) refuse("a comparison is allowed only in the first argument of where(condition, a, b)");
    close();
    return inside;
  }

  function close() {
    if (!isSign(")")) refuse(next() ? `'${next().text}' is out of place: a ')' is missing before it` : "a bracket is never closed: add ')'");
    at += 1;
  }

  function name(token) {
    if (!names.has(token.text)) {
      const sentence = `'${token.text}' is not a known name: known are ${[...names].join(", ")} and the functions; declare others as parameters`;
      throw new FormulaError(sentence, token.start, token.text);
    }
    at += 1;
    return add("name", token.text);
  }

  function call(token) {
    at += 2; // the name, and the bracket that spell() makes sure of
    const [least, most] = ARGUMENTS[token.text] ?? [1, 1];
    const given = [deeper(token.text === "where" ? condition : sum)];
    while (isSign(",")) {
      at += 1;
      given.push(deeper(sum));
    }
    if (given.length < least || given.length > most) refuse(`${token.text} takes ${least}${most > least ? " or more" : ""} argument${least > 1 ? "s" : ""}, not ${given.length}`);
    if (isSign(...COMPARISONS, "and", "or")) refuse("a comparison is allowed only in the first argument of where(condition, a, b)");
    close();
    return add(token.text, ...given);
  }

  const condition = () => chain(["or"], () => chain(["and"], negation));

  function negation() {
    if (isSign("not")) return (at += 1), add("not", deeper(negation));
    const before = at;
    if (isSign("(")) { // a condition in brackets, or a quantity that is compared
      at += 1;
      try {
        const inside = deeper(condition);
        close();
        if (!isSign("+", "-", "*", "/", "**", ...COMPARISONS)) return inside;
      } catch (error) {
        if (!(error instanceof FormulaError)) throw error;
      }
      at = before;
    }
    let left = sum();
    if (!isSign(...COMPARISONS)) refuse("a condition is needed here: a comparison such as x < 0.5");
    let result = -1;
    while (isSign(...COMPARISONS)) {
      const { text: sign } = tokens[at++];
      const right = sum();
      const link = add(sign, left, right);
      result = result < 0 ? link : add("and", result, link);
      left = right;
    }
    return result;
  }

  if (!tokens.length) throw new FormulaError("the expression is empty: write a formula in x and y");
  const result = sum();
  if (next()) refuse(isSign(")") ? "this ')' closes nothing: remove it, or add '('" : isSign(",") ? "',' is out of place: decimals take a point, as in 0.5" : isSign(...COMPARISONS, "and", "or", "not") ? "a comparison is allowed only in the first argument of where(condition, a, b)" : `'${next().text}' is out of place`);
  return { operations, result };
}

// Components of a value or of a derivative: an array over the points, one number for all of them, or null for zero.
// The loops write into arrays of a pool, which lives until the next evaluation, of any formula, at as many points.

/** A function that keeps what it made for the last few sizes: a key in a formula allocates no array anew. */
export function keeping(make, most = 16) {
  const known = new Map();
  return (...sizes) => {
    const key = sizes.join(" ");
    if (!known.has(key) && known.size === most) known.clear();
    if (!known.has(key)) known.set(key, make(...sizes));
    return known.get(key);
  };
}

const poolFor = keeping(createPool);

function createPool(size) {
  const arrays = [];
  let used = 0;
  return {
    size,
    take() {
      if (used === arrays.length) arrays.push(new Float64Array(size));
      return arrays[used++];
    },
    reset() {
      used = 0;
    },
  };
}

function each(pool, a, f) {
  if (typeof a === "number") return f(a);
  const out = pool.take();
  for (let k = 0; k < out.length; k += 1) out[k] = f(a[k]);
  return out;
}

function both(pool, a, b, f) {
  if (typeof a === "number") return each(pool, b, (value) => f(a, value));
  if (typeof b === "number") return each(pool, a, (value) => f(value, b));
  const out = pool.take();
  for (let k = 0; k < out.length; k += 1) out[k] = f(a[k], b[k]);
  return out;
}

function times(pool, a, b) {
  if (a === null || b === null || a === 0 || b === 0) return null;
  if (a === 1) return b;
  if (b === 1) return a;
  if (typeof a === "number") return typeof b === "number" ? a * b : times(pool, b, a);
  const out = pool.take();
  if (typeof b === "number") for (let k = 0; k < out.length; k += 1) out[k] = a[k] * b;
  else for (let k = 0; k < out.length; k += 1) out[k] = a[k] * b[k];
  return out;
}

function plus(pool, a, b) {
  if (a === null) return b;
  if (b === null) return a;
  if (typeof a === "number") return typeof b === "number" ? a + b : plus(pool, b, a);
  const out = pool.take();
  if (typeof b === "number") for (let k = 0; k < out.length; k += 1) out[k] = a[k] + b;
  else for (let k = 0; k < out.length; k += 1) out[k] = a[k] + b[k];
  return out;
}

const negative = (pool, a) => times(pool, a, -1);
const over = (pool, a, b) => (a === null ? null : both(pool, a, b, (p, q) => p / q));
// A value is never null: a product with zero is the number 0.
const value = (component) => component ?? 0;

function power(u, n) {
  if (!(Number.isInteger(n) && n >= 0 && n <= MOST_MULTIPLIED)) return u ** n;
  let result = 1;
  for (let base = u, left = n; left; left >>= 1, base *= base) if (left & 1) result *= base;
  return result;
}

/** The error function, by a series of terms of one sign. */
function erf(v) {
  if (Math.abs(v) > 6) return Math.sign(v);
  let term = v;
  let sum = v;
  for (let n = 1; Math.abs(term) > 1e-17 * Math.abs(sum); n += 1) {
    term *= (2 * v * v) / (2 * n + 1);
    sum += term;
  }
  return (2 / Math.sqrt(Math.PI)) * Math.exp(-v * v) * sum || v;
}

// Functions of one argument: the value at v, and the slope from v and the value f.
const SMOOTH = {
  sin: [Math.sin, (v) => Math.cos(v)],
  cos: [Math.cos, (v) => -Math.sin(v)],
  tan: [Math.tan, (v, f) => 1 + f * f],
  asin: [Math.asin, (v) => 1 / Math.sqrt(1 - v * v)],
  acos: [Math.acos, (v) => -1 / Math.sqrt(1 - v * v)],
  atan: [Math.atan, (v) => 1 / (1 + v * v)],
  sinh: [Math.sinh, (v) => Math.cosh(v)],
  cosh: [Math.cosh, (v) => Math.sinh(v)],
  tanh: [Math.tanh, (v, f) => 1 - f * f],
  asinh: [Math.asinh, (v) => 1 / Math.hypot(1, v)],
  acosh: [Math.acosh, (v) => 1 / Math.sqrt(v * v - 1)],
  atanh: [Math.atanh, (v) => 1 / (1 - v * v)],
  exp: [Math.exp, (v, f) => f],
  log: [Math.log, (v) => 1 / v],
  log2: [Math.log2, (v) => 1 / (v * Math.LN2)],
  log10: [Math.log10, (v) => 1 / (v * Math.LN10)],
  abs: [Math.abs, (v) => Math.sign(v)],
  sign: [Math.sign, () => 0],
  erf: [erf, (v) => (2 / Math.sqrt(Math.PI)) * Math.exp(-v * v)],
};

const COMPARE = {
  "<": (a, b) => +(a < b), "<=": (a, b) => +(a <= b), ">": (a, b) => +(a > b), ">=": (a, b) => +(a >= b),
  "==": (a, b) => +(a === b), "!=": (a, b) => +(a !== b), and: (a, b) => a && b, or: (a, b) => a || b,
};

// The derivatives of a function with the slope f1: 0 at the tip of a cone, where value and gradient vanish.
function chained(pool, a, f1, hasTip = false) {
  const slope = !hasTip || typeof a[0] === "number" ? f1 : tipless(pool, a, f1);
  return [times(pool, slope, a[1]), times(pool, slope, a[2])];
}

function tipless(pool, [u, u_x, u_y], f1) {
  const at = (component, k) => (component === null ? 0 : typeof component === "number" ? component : component[k]);
  const out = pool.take();
  for (let k = 0; k < out.length; k += 1) out[k] = u[k] === 0 && at(u_x, k) === 0 && at(u_y, k) === 0 ? 0 : f1[k];
  return out;
}

const isFlat = (a) => a[1] === null && a[2] === null;

function raise(pool, a, b) {
  const n = b[0];
  if (!isFlat(b) || typeof n !== "number") {
    const f = both(pool, a[0], n, Math.pow);
    const log = each(pool, a[0], (u) => (u === 0 ? 0 : Math.log(u)));
    const below = isFlat(a) ? null : times(pool, n, both(pool, a[0], n, (u, w) => u ** (w - 1)));
    return [f, ...[1, 2].map((i) => plus(pool, times(pool, below, a[i]), times(pool, times(pool, f, log), b[i])))];
  }
  if (n === 1) return a;
  if (Number.isInteger(n) && n < 0) return divide(pool, [1, null, null], raise(pool, a, [-n, null, null]));
  if (n === 0.5) return FUNCTIONS.sqrt(pool, a);
  const f = each(pool, a[0], (u) => power(u, n));
  if (isFlat(a)) return [f, null, null];
  const f1 = each(pool, a[0], (u) => n * power(u, n - 1));
  return [f, ...chained(pool, a, f1, n > 0.5 && !Number.isInteger(n))];
}

function divide(pool, a, b) {
  const q = both(pool, a[0], b[0], (p, r) => p / r);
  const slope = (i) => over(pool, plus(pool, a[i], negative(pool, times(pool, q, b[i]))), b[0]);
  return [q, slope(1), slope(2)];
}

// a where the condition is not 0, else b.
function pick(pool, condition, a, b) {
  if (typeof condition === "number") return condition ? a : b;
  const [one, other] = [value(a), value(b)];
  const out = pool.take();
  for (let k = 0; k < out.length; k += 1) {
    const taken = condition[k] ? one : other;
    out[k] = typeof taken === "number" ? taken : taken[k];
  }
  return out;
}

function extremum(choose) {
  const pair = (pool, a, b) => {
    const share = both(pool, a[0], b[0], (p, q) => (p === q ? 0.5 : choose(p, q) === p ? 1 : 0));
    const rest = each(pool, share, (one) => 1 - one);
    const slope = (i) => plus(pool, times(pool, share, a[i]), times(pool, rest, b[i]));
    return [both(pool, a[0], b[0], choose), slope(1), slope(2)];
  };
  return (pool, ...given) => given.reduce((a, b) => pair(pool, a, b));
}

// The functions of the language and its operators, on [value, derivative by x, derivative by y].
const FUNCTIONS = {
  ...Object.fromEntries(Object.entries(SMOOTH).map(([name, [f, slope]]) => [name, (pool, a) => {
    const found = each(pool, a[0], f);
    return isFlat(a) ? [found, null, null] : [found, ...chained(pool, a, both(pool, a[0], found, slope))];
  }])),
  sqrt(pool, a) {
    const f = each(pool, a[0], Math.sqrt);
    return isFlat(a) ? [f, null, null] : [f, ...chained(pool, a, each(pool, f, (root) => 0.5 / root), true)];
  },
  atan2(pool, a, b) {
    const f = both(pool, a[0], b[0], Math.atan2);
    const square = both(pool, a[0], b[0], (p, q) => p * p + q * q);
    const [by_a, by_b] = [over(pool, b[0], square), negative(pool, over(pool, a[0], square))];
    return [f, ...[1, 2].map((i) => plus(pool, times(pool, by_a, a[i]), times(pool, by_b, b[i])))];
  },
  hypot(pool, a, b) {
    const h = both(pool, a[0], b[0], (p, q) => Math.hypot(p, q));
    const share = (c) => both(pool, c[0], h, (p, root) => (root === 0 ? 0 : p / root));
    const [by_a, by_b] = [share(a), share(b)];
    return [h, ...[1, 2].map((i) => plus(pool, times(pool, by_a, a[i]), times(pool, by_b, b[i])))];
  },
  min: extremum((p, q) => (Number.isNaN(p) ? p : Math.min(p, q))),
  max: extremum((p, q) => (Number.isNaN(p) ? p : Math.max(p, q))),
  where: (pool, condition, a, b) => a.map((one, i) => pick(pool, condition[0], one, b[i])),
};
const OPERATORS = {
  "+": (pool, a, b) => [plus(pool, a[0], b[0]), plus(pool, a[1], b[1]), plus(pool, a[2], b[2])],
  "-": (pool, a, b) => OPERATORS["+"](pool, a, OPERATORS.negative(pool, b)),
  "*": (pool, a, b) => [
    value(times(pool, a[0], b[0])),
    ...[1, 2].map((i) => plus(pool, times(pool, a[i], b[0]), times(pool, a[0], b[i]))),
  ],
  "/": divide,
  "**": raise,
  negative: (pool, a) => [value(negative(pool, a[0])), negative(pool, a[1]), negative(pool, a[2])],
  not: (pool, a) => [each(pool, a[0], (one) => +!one), null, null],
  ...Object.fromEntries(Object.entries(COMPARE).map(([name, f]) => [name, (pool, a, b) => [both(pool, a[0], b[0], f), null, null]])),
};

/**
 * A formula as a function of points: `evaluate(x, y)` gives arrays `[u, u_x, u_y]`, which the next evaluation at as
 * many points overwrites, of this or another formula; `values(x, y)` gives u alone, in a third of the time.  `names` are those that occur, with their values in `constants`: the parameters, and t.
 *
 * Throws a `FormulaError` for a text that is not in the language.
 *
 * @param {string} text
 * @param {Record<string, number>} [constants] parameters, and t (0 unless given)
 * @param {string[]} [variables] the names of the two coordinates
 */
export function compile(text, constants = {}, variables = ["x", "y"]) {
  const known = { t: 0, ...constants, pi: Math.PI, e: Math.E };
  for (const name of variables) delete known[name];
  const { operations, result } = parse(text, new Set([...variables, ...Object.keys(known)]));

  // Without slopes of the coordinates nothing has any: all of them are null, and no loop computes them.
  function run(x, y, slope) {
    const leaves = { [variables[0]]: [x, slope, null], [variables[1]]: [y, null, slope] };
    const pool = poolFor(x.length);
    pool.reset();
    const values = [];
    for (const [name, ...given] of operations) {
      if (name === "number") values.push([given[0], null, null]);
      else if (name === "name") values.push(leaves[given[0]] ?? [known[given[0]], null, null]);
      else values.push((OPERATORS[name] ?? FUNCTIONS[name])(pool, ...given.map((k) => values[k])));
    }
    const filled = (component) => (component instanceof Float64Array ? component : pool.take().fill(value(component)));
    return slope === null ? [filled(values[result][0])] : values[result].map(filled);
  }
  const names = operations.filter(([name]) => name === "name").map(([, name]) => name);
  return { text, names, constants: known, evaluate: (x, y) => run(x, y, 1), values: (x, y) => run(x, y, null)[0] };
}
