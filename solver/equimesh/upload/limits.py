"""The limits of a file of samples: reading stops where one is exceeded."""

import sys
from dataclasses import dataclass
from typing import Final

from equimesh.errors import SamplesError

# The most lines without a sample in a csv file whose number of samples is limited, besides one for each sample.
MAX_OTHER_LINES: Final = 10_000
# The most sections and arrays of a legacy vtk file.
MAX_SECTIONS: Final = 10_000
# The most columns of a csv file.
MAX_COLUMNS: Final = 1000
# The most values of a json file besides those of its samples.
_MAX_OTHER_VALUES: Final = 10_000
# The values of one scattered sample in a json file: x, y, u, and the list of the point.
_VALUES_OF_SAMPLE: Final = 4
# The most bytes of the numbers of one sample in one array: x and y.
_BYTES_OF_SAMPLE: Final = 16
# The most bytes of the header of an npy file.
_HEADER_BYTES: Final = 65_536


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The most bytes of the arrays of a file when they are unpacked, and the most samples."""

    max_bytes: int
    max_samples: int = sys.maxsize

    @property
    def max_lines(self) -> int:
        """The most lines of a csv file."""
        return 2 * self.max_samples + MAX_OTHER_LINES

    @property
    def max_values(self) -> int:
        """The most values of a json file."""
        return _VALUES_OF_SAMPLE * self.max_samples + _MAX_OTHER_VALUES

    @property
    def max_npy_bytes(self) -> int:
        """The most bytes of an npy file: one with more has too many samples, whatever the type of its numbers."""
        return _BYTES_OF_SAMPLE * self.max_samples + _HEADER_BYTES

    def check(self, number: int, most: int | None = None) -> None:
        """Raise :class:`~equimesh.errors.SamplesError` for more than ``most``: ``max_samples``, unless it is given."""
        if number > (self.max_samples if most is None else most):
            raise SamplesError(f"the file has more than {self.max_samples} samples, the limit: send fewer")
