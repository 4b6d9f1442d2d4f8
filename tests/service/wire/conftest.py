"""Files of each kind, to be sent."""

from service.storages import files, s3

__all__ = ["files", "s3"]
