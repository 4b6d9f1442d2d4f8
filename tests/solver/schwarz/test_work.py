"""Work and traffic of an iteration, counted by hand."""

from __future__ import annotations

import equimesh as em
from equimesh.schwarz.families import subdomains_of
from equimesh.schwarz.records import SubdomainRecord
from equimesh.schwarz.work import traffic, work
from solver.schwarz.runs import PAPER

SETTINGS = em.Schwarz(transmission=em.Classical(), subdomains=(2, 1), overlap=4)
STRIPS = SETTINGS.decompose(PAPER.grid)
SUBDOMAINS = subdomains_of(PAPER, STRIPS, SETTINGS, enough=0.0, threads=1)  # of 14 columns each, of 20 points


def test_nodes_are_counted_as_often_as_they_were_corrected() -> None:
    records = [
        SubdomainRecord(subdomain=0, newton_steps=3, residual=0.0),
        SubdomainRecord(subdomain=1, newton_steps=0, residual=0.0, sweeps=5),
    ]
    assert work(PAPER.grid, SUBDOMAINS, records, 0) == 14 * 20 * (3 + 5)
    assert work(PAPER.grid, SUBDOMAINS, records, 2) == 14 * 20 * (3 + 5) + 2 * 24 * 20


def test_each_strip_receives_two_coordinates_of_a_line() -> None:
    assert traffic(PAPER.grid, SETTINGS, SUBDOMAINS, [[0, 1]], 0) == 8 * 2 * (2 * 20)
    assert traffic(PAPER.grid, SETTINGS, SUBDOMAINS, [[0], [1], [0]], 0) == 8 * 3 * (2 * 20)
    assert traffic(PAPER.grid, SETTINGS, SUBDOMAINS, [[0, 1]], 3) == 8 * (2 * (2 * 20) + 3 * 6 * 20)
