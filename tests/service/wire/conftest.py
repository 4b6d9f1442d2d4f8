"""Files of each kind, which are sent."""

from service.storages import files, s3

__all__ = ["files", "s3"]
