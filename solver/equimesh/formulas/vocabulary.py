"""The language of expressions: its names, its limits, and advice for names and characters that it does not have."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

#: Every function of the language, and its result.
FUNCTIONS: Mapping[str, str] = MappingProxyType(
    {
        "sin": "sine of an angle in radians",
        "cos": "cosine of an angle in radians",
        "tan": "tangent of an angle in radians",
        "asin": "angle in [-pi/2, pi/2] with the given sine",
        "acos": "angle in [0, pi] with the given cosine",
        "atan": "angle in (-pi/2, pi/2) with the given tangent",
        "atan2": "atan2(b, a): angle of the point (a, b), in (-pi, pi]",
        "sinh": "hyperbolic sine",
        "cosh": "hyperbolic cosine",
        "tanh": "hyperbolic tangent, the usual steep front: tanh(60*(x - 0.5))",
        "asinh": "inverse hyperbolic sine",
        "acosh": "inverse hyperbolic cosine, of an argument of at least 1",
        "atanh": "inverse hyperbolic tangent, of an argument between -1 and 1",
        "exp": "exponential function",
        "log": "natural logarithm, of a positive argument",
        "log2": "logarithm to base 2, of a positive argument",
        "log10": "logarithm to base 10, of a positive argument",
        "sqrt": "square root, of an argument that is not negative",
        "abs": "absolute value (slope 0 at 0)",
        "sign": "-1, 0 or 1 (slope 0 everywhere)",
        "min": "smallest of two or more arguments (mean slope at a tie)",
        "max": "largest of two or more arguments (mean slope at a tie)",
        "hypot": "hypot(a, b): sqrt(a**2 + b**2) (slope 0 at 0)",
        "erf": "error function",
        "where": "where(condition, a, b): a where the condition holds, else b: where(x < 0.5, 1, 2*y)",
    }
)
#: The names with a fixed meaning, which no parameter can take.
RESERVED = ("x", "y", "t", "pi", "e")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The limits of one expression, so that it cannot delay a solve."""

    length: int = 4096  # characters of the text
    depth: int = 100  # brackets, signs and powers inside one another
    nodes: int = 1000  # operations, names and numbers
    digits: int = 40  # characters of one number
    exponent: float = 1000.0  # size of a constant exponent
    parameters: int = 100
    magnitude: float = 1e100  # size of u and of its gradient: their squares must not overflow


LIMITS = Limits()


@dataclass(frozen=True, kw_only=True)
class Language:
    """The names of a formula: its ``variables``, and all ``names`` that it has in addition to its parameters.

    ``example`` and ``comparison`` show a formula and a comparison in messages. ``foreign`` gives advice for names of
    another kind of formula.
    """

    variables: tuple[str, ...]
    names: tuple[str, ...]
    example: str
    comparison: str
    foreign: Mapping[str, str] = field(default_factory=dict, hash=False)


#: A function of the plane; t is a constant.
PLANE = Language(
    variables=("x", "y"), names=("x", "y", "t", "pi", "e"), example="tanh(20*(x - y))", comparison="x < 0.5"
)
_ALONG = "a curve is given by formulas in t: write t, which goes from 0 to 1 along it"
#: A coordinate of the points of a curve.
CURVE = Language(
    variables=("t",),
    names=("t", "pi", "e"),
    example="cos(pi*t/2)",
    comparison="t < 0.5",
    foreign=MappingProxyType({"x": _ALONG, "y": _ALONG}),
)

#: Smallest and largest number of arguments where it is not one; None: any number.
ARGUMENTS: Mapping[str, tuple[int, int | None]] = MappingProxyType(
    {"atan2": (2, 2), "hypot": (2, 2), "min": (2, None), "max": (2, None), "where": (3, 3)}
)

#: Signs that people type or paste, and those of the language.
SAME_SIGNS: Mapping[str, str] = MappingProxyType(
    {
        "^": "**",
        **dict.fromkeys("\u00d7\u00b7\u22c5\u2219\u2217", "*"),  # times, dots, asterisk
        **dict.fromkeys("\u00f7\u2215\u2044", "/"),  # division, slashes
        **dict.fromkeys("\u2212\u2013\u2010\u2011", "-"),  # minus, en dash, hyphens
        "\u2264": "<=",
        "\u2265": ">=",
        "\u2260": "!=",
    }
)

#: Raised digits, which are a power, and the sign in front of them.
RAISED: Mapping[str, str] = MappingProxyType(
    {digit: str(k) for k, digit in enumerate("\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")}
)
RAISED_MINUS = "\u207b"

#: The Greek letter, a name of its own in every word.
PI = "\u03c0"

#: Names that mean the same elsewhere, and the names here. A parameter of such a name stays what it is.
SAME_NAMES: Mapping[str, str] = MappingProxyType(
    {
        PI: "pi",
        "ln": "log",
        **{f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan", "tan2", "sinh", "cosh", "tanh")},
        "fabs": "abs",
        "absolute": "abs",
        "maximum": "max",
        "minimum": "min",
        "sgn": "sign",
    }
)

#: Advice for characters that do not belong to the language.
CHARACTER_REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "//": "use / for a quotient",
        "%": "there is no remainder",
        ":=": "nothing can be assigned; declare a parameter instead",
        "=>": "write >=",
        "=<": "write <=",
        "=": "write == to compare, inside where(...); declare parameters apart from the expression",
        "&": "write and, inside where(...)",
        "~": "write not, inside where(...)",
        "!": "write not, inside where(...)",
        "@": "use * for a product",
        "[": "group with ( and )",
        "]": "group with ( and )",
        "{": "group with ( and )",
        "}": "group with ( and )",
        "'": "text is not part of the language",
        '"': "text is not part of the language",
        ".": "a point belongs inside a number; x.sin() and the like are not part of the language",
        "#": "comments are not part of the language",
        "—": "use the plain minus sign -",
        "√": "write sqrt(...)",
        "∞": "there is no infinity",
    }
)

#: Names of other languages, and the names here.
OTHER_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "pow": "** for powers",
        "power": "** for powers",
        "step": "where(condition, a, b)",
        "heaviside": "where(condition, a, b)",
        "Piecewise": "where(condition, a, b)",
        "if": "where(condition, a, b)",
        "else": "where(condition, a, b)",
    }
)
