"""Types of arrays."""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
SingleArray: TypeAlias = npt.NDArray[np.float32]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
Pair: TypeAlias = tuple[Array, Array]
"""Two arrays, one for x and one for y."""
IntPair: TypeAlias = tuple[IntArray, IntArray]
"""Two numbers of each thing, such as the row and the column of a cell."""
