"""Iterations that are made up: subdomains that solved, stalled, or took classical data."""

from __future__ import annotations

import equimesh as em
from equimesh.schwarz.records import SubdomainRecord
from equimesh.schwarz.subdomains import MergedSolutions


def solved(mesh: em.Mesh, *, stalled: bool = False, classical: bool = False, mismatch: float = 0.0) -> MergedSolutions:
    """Two subdomains, the second of which stalled or took classical data, merged to a mesh."""
    records = (
        SubdomainRecord(subdomain=0, newton_steps=3, residual=1e-12),
        SubdomainRecord(subdomain=1, newton_steps=9, residual=1e-3, stalled=stalled, classical=classical),
    )
    return MergedSolutions(mesh, (mesh, mesh), records, mismatch)
