"""Options for the address of a service."""

import os
from typing import Any

DEFAULT_URL = "http://127.0.0.1:8000"


def add_url(parser: Any, *, default: str | None) -> None:
    """Add --url and --key, which EQUIMESH_URL and EQUIMESH_KEY also set."""
    shown_default = f" ({default})" if default else ""
    parser.add_argument(
        "--url",
        default=os.environ.get("EQUIMESH_URL") or default,
        help=f"address of the service; also EQUIMESH_URL{shown_default}",
    )
    parser.add_argument(
        "--key", help="API key; better in EQUIMESH_KEY, since other users of this machine can read options"
    )
