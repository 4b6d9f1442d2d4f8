"""A request in one npz: the spec as a text, and the samples as arrays. Numbers are sent as they are in memory."""

import io

import numpy as np

from equimesh.errors import SamplesError
from equimesh.upload.zip_members import open_zip
from equimesh_service.assembly.problem import translate_errors
from equimesh_service.assembly.samples import Upload
from equimesh_service.problems.problem import Problem

# The array with the spec.
SPEC = "spec"
# The most bytes of that array: 1 MiB of text, four bytes for each character.
MAX_SPEC_BYTES = 4 * 1024 * 1024
_REMEDY = "write it with numpy.savez(file, spec=json.dumps(spec), x=x, y=y, values=values)"


def unpack(data: bytes) -> tuple[bytes, Upload | None]:
    """The bytes of the spec, and the samples, where there are other arrays; raises 400 and 422 problems."""
    with translate_errors(), open_zip(data, "npz", MAX_SPEC_BYTES, _REMEDY) as members:
        if f"{SPEC}.npy" not in members.names:
            raise Problem("malformed-body", f"The npz has no array {SPEC!r}: {_REMEDY}.")
        spec = _text(members.read(f"{SPEC}.npy"))
        others = len(members.names) > 1
    return spec, Upload(data, "samples.npz") if others else None


def _text(member: bytes) -> bytes:
    """The UTF-8 bytes of a text that was saved as an array: one text, or its bytes."""
    try:
        array = np.load(io.BytesIO(member), allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError, TypeError, MemoryError, RecursionError) as error:
        raise SamplesError(f"the array spec cannot be read ({type(error).__name__})", field=SPEC) from None
    if array.dtype.kind in "US" and array.size == 1:
        text = array.item()
        return text.encode("utf-8", "surrogatepass") if isinstance(text, str) else bytes(text)
    if array.dtype == np.uint8 and array.ndim == 1:
        return bytes(array.tobytes())
    raise SamplesError(f"spec has the type {array.dtype} and the shape {array.shape}: it must be one text", field=SPEC)
