"""The address of the files in the settings: picklable, so that workers open the same storage."""

import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

from pydantic import SecretStr

from equimesh_service.errors import FilesError
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files
from equimesh_service.files.s3 import Bucket, S3Files
from equimesh_service.settings import Settings

_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
_NONE = SecretStr("")
_ADDRESS_FORMS = "s3://bucket/prefix, or file:///folder"


@dataclass(frozen=True, kw_only=True)
class FilesAddress:
    """The address of the files, and the local folder of the files or of their temporary files."""

    folder: Path
    url: str = ""
    endpoint: str = ""
    region: str = "us-east-1"
    access_key: SecretStr = _NONE
    secret_key: SecretStr = _NONE

    def open(self) -> Files:
        """The files behind the address; raises :class:`FilesError` for one that cannot be used."""
        parts = urlsplit(self.url)
        if not self.url:
            return FolderFiles(self.folder)
        if parts.scheme == "file" and parts.netloc in ("", "localhost") and parts.path.startswith("/"):
            return FolderFiles(Path(unquote(parts.path)))
        if parts.scheme != "s3":
            raise FilesError(f"EQUIMESH_FILES_URL is {_hide_secrets(self.url)}: it must be {_ADDRESS_FORMS}")
        return S3Files(self._bucket(), self.folder)

    def _bucket(self) -> Bucket:
        parts = urlsplit(self.url)
        if parts.username is not None or parts.query or parts.fragment or not _BUCKET.fullmatch(parts.netloc):
            raise FilesError(f"EQUIMESH_FILES_URL is {_hide_secrets(self.url)}: no name of a bucket follows s3://")
        if self.endpoint and not _is_web_address(self.endpoint):
            raise FilesError("EQUIMESH_S3_ENDPOINT must be an address such as https://s3.example.org, without a path")
        if bool(self.access_key.get_secret_value()) != bool(self.secret_key.get_secret_value()):
            raise FilesError("EQUIMESH_S3_ACCESS_KEY and EQUIMESH_S3_SECRET_KEY go together: one of them is empty")
        if find_spec("obstore") is None:
            raise FilesError("files in S3 need one more package: pip install 'equimesh[s3]'")
        return Bucket(
            name=parts.netloc,
            prefix=unquote(parts.path).strip("/"),
            endpoint=self.endpoint.rstrip("/"),
            region=self.region,
            access_key=self.access_key,
            secret_key=self.secret_key,
        )


def files_address(settings: Settings) -> FilesAddress:
    """The address of the files of a service with these settings."""
    return FilesAddress(
        folder=settings.data_dir.resolve() / "files",
        url=settings.files_url,
        endpoint=settings.s3_endpoint,
        region=settings.s3_region,
        access_key=settings.s3_access_key,
        secret_key=settings.s3_secret_key,
    )


def _is_web_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
        usable = parts.hostname and (parts.port or True) and parts.username is None
    except ValueError:
        return False
    return bool(usable) and parts.scheme in ("http", "https") and not (parts.path.strip("/") or parts.query)


def _hide_secrets(url: str) -> str:
    """An address without its user and password."""
    return repr(re.sub(r"//[^/@]*@", "//…@", url)[:200])
