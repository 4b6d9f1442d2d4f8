"""What the parts of one computation contribute, known to every part.

A computation over parts calls a :data:`Gather` with its own arrays. It gets those of all parts, in the order of the
parts. All parts make the same calls in the same order, and decide from the same numbers.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from equimesh.numerics.types import Array

Gather: TypeAlias = Callable[[Array], Sequence[Array]]
"""From the array of this part to those of all parts, in their order."""


def alone(array: Array) -> Sequence[Array]:
    """The gathering of a computation that has one part."""
    return (array,)


def joined(gather: Gather, array: Array) -> Array:
    """The rows of all parts, one part after the other."""
    found = gather(array)
    return array if len(found) == 1 else np.concatenate(found)


def summed(gather: Gather, array: Array) -> Array:
    """The sum of the arrays of all parts, which have one shape; added in the order of the parts."""
    found = gather(array)
    return array if len(found) == 1 else np.asarray(np.sum(np.stack(found), axis=0))
