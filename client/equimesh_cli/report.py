"""What `solve` and `generate` tell of a mesh: one line to read first, then warnings, then the numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from equimesh_client import Certificate


def print_report(certificate: Certificate | None, points: int | str, message: str) -> None:
    """Print what a mesh of so many ``points`` is worth, how the solve ended, and the rest of its certificate."""
    if certificate is None:
        print(f"{points} points: {message}")
        return
    print(certificate.headline)
    print(f"{points} points. {message}")
    for warning in certificate.warnings:
        print(f"warning: {warning}")
    print(f"\nDetails:\n{certificate.details}")
