"""What the parts of one computation found, joined or added, and known to every part.

All parts make the same calls in the same order, and decide from the same numbers.
"""

from collections.abc import Sequence

import numpy as np

from equimesh.numerics.channel import Channel
from equimesh.numerics.communicator import gather
from equimesh.numerics.types import Array

TAG = "measure"
"""The tag of the messages."""


def gathered(channel: Channel, array: Array) -> Sequence[Array]:
    """The arrays of all parts, in their order."""
    return [found for (found,) in gather(channel, TAG, [array])]


def joined(channel: Channel, array: Array) -> Array:
    """The rows of all parts, one part after the other."""
    return array if channel.count == 1 else np.concatenate(gathered(channel, array))


def summed(channel: Channel, array: Array) -> Array:
    """The sum of the arrays of all parts, which have one shape; added in the order of the parts."""
    return array if channel.count == 1 else np.asarray(np.sum(np.stack(gathered(channel, array)), axis=0))
