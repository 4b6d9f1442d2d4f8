"""The root of all exceptions of equimesh, and those of meshes that are coupled to other libraries.

::

    EquimeshError             the root of the solver, and of the client under the name EquimeshClientError
    └── CouplingError         a mesh does not reach another library, or values do not come back
        ├── MissingLibrary    the library is not installed, or does not load (also an ImportError)
        ├── OldLibrary        the library is older than what the adaptor needs (also an ImportError)
        └── BadValues         what a solver returned cannot be used on the mesh (also a ValueError)
"""


class EquimeshError(Exception):
    """Root of every exception that equimesh raises on purpose."""


class CouplingError(EquimeshError):
    """A mesh that does not reach another library, or values that do not come back."""


class MissingLibrary(CouplingError, ImportError):
    """A library that is not installed, or that does not load; the message names its package."""


class OldLibrary(CouplingError, ImportError):
    """A library that is older than what the adaptor needs; the message names both versions."""


class BadValues(CouplingError, ValueError):
    """Values of a solver that cannot be used: another length, not finite, or cell averages in place of nodal ones."""
