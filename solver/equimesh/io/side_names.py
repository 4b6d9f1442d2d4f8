"""Names of sides for formats that take no spaces, quotes or braces in them."""

import re
from collections.abc import Iterable

# What a name may not have in OpenFOAM, SU2 and neutral map files.
NOT_IN_WORDS = re.compile(r"[^A-Za-z0-9_.:+-]")
# What it may not have between the quotes of a Gmsh file.
NOT_IN_QUOTES = re.compile(r'["\r\n]')


def words(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """A word for each name: the name itself where it is one, else with ``_`` for what a word cannot have.

    Words differ from each other and from those that are ``taken``: of equal ones the later get a number.
    """
    return _distinct(names, NOT_IN_WORDS, taken)


def quoted(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """As :func:`words` for names between quotes, which may have spaces."""
    return _distinct(names, NOT_IN_QUOTES, taken)


def _distinct(names: Iterable[str], refused: re.Pattern[str], taken: Iterable[str]) -> dict[str, str]:
    names, used, found = [*names], {*taken}, dict[str, str]()
    own = {name for name in names if name and not refused.search(name) and name not in used}
    for name in names:
        if name in own:
            found[name] = name
            continue
        word = plain = refused.sub("_", name) or "side"
        number = 2
        while word in used | own:
            word, number = f"{plain}_{number}", number + 1
        used.add(word)
        found[name] = word
    return found
