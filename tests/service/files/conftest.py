"""Files of each kind, and a server of the S3 protocol."""

from service.storages import files, s3

__all__ = ["files", "s3"]
