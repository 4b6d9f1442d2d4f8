"""A real browser without a window, which can reach nothing but loopback addresses."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from programs import browser

# No sandbox, as tests may run as root in a container.
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--virtual-time-budget=20000",
    "--window-size=1200,2000",
]
# No name resolves.
NOTHING = "MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE 127.0.0.2"


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page after its scripts have run: its document, and what it wrote to the console."""

    document: str
    complaints: list[str]


def visit(address: str, profile: Path, **names: str) -> Page:
    """Open a page; ``names`` are hosts, with ``_`` for each dot, and the addresses to which they resolve."""
    known = ", ".join(f"MAP {name.replace('_', '.')} {address}" for name, address in names.items())
    command = [
        str(browser()),
        *FLAGS,
        f"--host-resolver-rules={known}, {NOTHING}" if known else f"--host-resolver-rules={NOTHING}",
        f"--user-data-dir={profile}",
        "--dump-dom",
        address,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return Page(document=done.stdout, complaints=[line for line in done.stderr.splitlines() if ":CONSOLE" in line])
