"""A request in one npz: the spec as a text, and the samples as arrays. Numbers are sent as they are in memory."""

import re

from equimesh.errors import SamplesError
from equimesh.io.reading.bounds import open_zip
from equimesh_service.assembly.problem import translate_errors
from equimesh_service.assembly.samples import Upload
from equimesh_service.problems.problem import Problem

# The array with the spec.
SPEC = "spec"
# The most bytes of that array: 1 MiB of text, four bytes for each character.
MAX_SPEC_BYTES = 4 * 1024 * 1024
_REMEDY = "write it with numpy.savez(file, spec=json.dumps(spec), x=x, y=y, values=values)"
# The header of an npy file of texts or bytes, as NumPy writes it; other headers take NumPy long to understand.
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '[<|](?P<kind>[USu])(?P<size>[0-9]{1,8})', 'fortran_order': False, "
    rb"'shape': \((?P<shape>|1,|[0-9]{1,8},)\), \} *\n",
    re.DOTALL,
)


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
    head = _HEADER.match(member)
    is_text = head is not None and head["kind"] != b"u" and head["shape"] in (b"", b"1,")
    is_bytes = head is not None and (head["kind"], head["size"]) == (b"u", b"1")
    if head is None or not (is_text or is_bytes):
        raise SamplesError("the array spec must be one text, or its bytes", field=SPEC)
    content = member[head.end() :]
    width = {b"U": 4, b"S": 1, b"u": 1}[head["kind"]]
    number = int(head["shape"][:-1] or 0) if is_bytes else int(head["size"])
    if len(content) != width * number:
        raise SamplesError("the array spec does not have its stated length", field=SPEC)
    if head["kind"] != b"U":
        return content.rstrip(b"\0")
    try:
        return content.decode("utf-32-le").rstrip("\0").encode()
    except UnicodeError:
        raise SamplesError("the array spec is not a text", field=SPEC) from None
