"""Steps from the tables of an older release to those of :mod:`equimesh_service.store.schema`, for alembic."""
