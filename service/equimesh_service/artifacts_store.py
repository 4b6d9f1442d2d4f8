"""SQL of the files that rows name: shared by their content, removed with the last row that names them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from sqlalchemy import Connection, delete, insert, select

from equimesh_service.rows import Artifact
from equimesh_service.schema import artifacts, samples


def insert_artifact(connection: Connection, mesh_id: str, file: Artifact) -> None:
    """Give a mesh a file under its name, in place of an older one."""
    here = (artifacts.c.mesh_id == mesh_id, artifacts.c.name == file.name)
    connection.execute(delete(artifacts).where(*here))
    connection.execute(insert(artifacts).values(mesh_id=mesh_id, **vars(file)))


def remove_unused(connection: Connection, held: Iterable[str], remove_file: Callable[[str], None]) -> None:
    """Give those files ``held`` that no row names any more to ``remove_file``.

    Inside the transaction: no row that names the file can be added between the look and the removal.
    """
    for sha256 in held:
        in_artifacts = select(artifacts.c.sha256).where(artifacts.c.sha256 == sha256).limit(1)
        in_samples = select(samples.c.sha256).where(samples.c.sha256 == sha256).limit(1)
        if connection.execute(in_artifacts).first() is None and connection.execute(in_samples).first() is None:
            remove_file(sha256)
