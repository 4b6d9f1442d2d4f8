// Expressions in the browser, to draw curves while they are typed.  The service reads them itself, and has the last word.

const TOKEN = /\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|(\*\*|<=|>=|==|!=|[-+*/(),<>]))/y;
const CONSTANTS = { pi: Math.PI, e: Math.E };
const FUNCTIONS = {
  ...Object.fromEntries(
    ["sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "log",
      "log2", "log10", "sqrt", "abs", "sign", "min", "max", "hypot"].map((name) => [name, Math[name]]),
  ),
  erf,
};

/** The names that the language knows besides x and y. */
export const NAMES = [...Object.keys(FUNCTIONS), "where"].map((name) => ({ name, isFunction: true })).concat({ name: "pi", isFunction: false });

const COMPARISONS = {
  "<": (a, b) => a < b,
  "<=": (a, b) => a <= b,
  ">": (a, b) => a > b,
  ">=": (a, b) => a >= b,
  "==": (a, b) => a === b,
  "!=": (a, b) => a !== b,
};

/**
 * A function of the values of names, for an expression; null where it cannot be read.
 *
 * @param {string} text in the language of the service
 * @returns {((names: Object<string, number>) => number) | null} NaN for names without a value
 */
export function compile(text) {
  try {
    const parser = new Parser(tokensOf(text));
    const value = parser.condition();
    return parser.isAtEnd ? (names) => Number(value({ ...CONSTANTS, ...names })) : null;
  } catch {
    return null;
  }
}

function tokensOf(text) {
  const tokens = [];
  const rest = text.trimEnd();
  TOKEN.lastIndex = 0;
  while (TOKEN.lastIndex < rest.length) {
    const found = TOKEN.exec(rest);
    if (!found) throw new Error("not in the language");
    const [, number, name, sign] = found;
    tokens.push({ number, name, sign });
  }
  return tokens;
}

// By recursive descent, from what binds least to what binds most.  Each method returns a function of the names.
class Parser {
  constructor(tokens) {
    this.tokens = tokens;
    this.place = 0;
  }

  get isAtEnd() {
    return this.place === this.tokens.length;
  }

  take(...signs) {
    const token = this.tokens[this.place];
    const text = token?.sign ?? token?.name;
    if (!signs.includes(text)) return null;
    this.place += 1;
    return text;
  }

  need(sign) {
    if (!this.take(sign)) throw new Error(`${sign} is missing`);
  }

  condition() {
    let left = this.conjunction();
    while (this.take("or")) left = joined(left, this.conjunction(), (a, b) => a || b);
    return left;
  }

  conjunction() {
    let left = this.negation();
    while (this.take("and")) left = joined(left, this.negation(), (a, b) => a && b);
    return left;
  }

  negation() {
    if (!this.take("not")) return this.comparison();
    const inner = this.negation();
    return (names) => !inner(names);
  }

  comparison() {
    const left = this.sum();
    const sign = this.take(...Object.keys(COMPARISONS));
    return sign ? joined(left, this.sum(), COMPARISONS[sign]) : left;
  }

  sum() {
    let left = this.product();
    for (let sign; (sign = this.take("+", "-")); ) {
      left = joined(left, this.product(), sign === "+" ? (a, b) => a + b : (a, b) => a - b);
    }
    return left;
  }

  product() {
    let left = this.signed();
    for (let sign; (sign = this.take("*", "/")); ) {
      left = joined(left, this.signed(), sign === "*" ? (a, b) => a * b : (a, b) => a / b);
    }
    return left;
  }

  signed() {
    const sign = this.take("+", "-");
    if (!sign) return this.power();
    const inner = this.signed();
    return sign === "-" ? (names) => -inner(names) : inner;
  }

  // A power binds more than the sign before it, and less than the sign after it.
  power() {
    const base = this.atom();
    return this.take("**") ? joined(base, this.signed(), (a, b) => a ** b) : base;
  }

  atom() {
    if (this.take("(")) {
      const inner = this.condition();
      this.need(")");
      return inner;
    }
    const { number, name } = this.tokens[this.place++] ?? {};
    if (number !== undefined) return () => Number(number);
    if (name === undefined) throw new Error("a number or a name is missing");
    return this.take("(") ? this.call(name) : (names) => (Object.hasOwn(names, name) ? names[name] : Number.NaN);
  }

  call(name) {
    const values = [this.condition()];
    while (this.take(",")) values.push(this.condition());
    this.need(")");
    if (name === "where") return (names) => (values[0](names) ? values[1](names) : values[2](names));
    if (!Object.hasOwn(FUNCTIONS, name)) throw new Error(`${name} is unknown`);
    return (names) => FUNCTIONS[name](...values.map((value) => value(names)));
  }
}

const joined = (left, right, operation) => (names) => operation(left(names), right(names));

// Abramowitz and Stegun 7.1.26: to seven digits, which is enough for a drawing.
function erf(x) {
  const t = 1 / (1 + 0.3275911 * Math.abs(x));
  const sum = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
  return Math.sign(x) * (1 - sum * Math.exp(-x * x));
}
