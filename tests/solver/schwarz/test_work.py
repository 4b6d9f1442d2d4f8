"""Work and traffic of an iteration, counted by hand."""

from __future__ import annotations

import equimesh as em
from equimesh.schwarz.iteration import subdomains_of, traffic, work
from equimesh.schwarz.merged_mesh import InOneProcess
from equimesh.schwarz.records import SubdomainRecord
from solver.schwarz.runs import PAPER

SETTINGS = em.Schwarz(transmission=em.Classical(), subdomains=(2, 1), overlap=4)
STRIPS = SETTINGS.decompose(PAPER.grid)
SUBDOMAINS = subdomains_of(
    PAPER, InOneProcess(STRIPS), SETTINGS, enough=0.0, threads=1
)  # of 14 columns each, of 20 points


def test_nodes_are_counted_as_often_as_they_were_corrected() -> None:
    records = [
        SubdomainRecord(subdomain=0, newton_steps=3, residual=0.0),
        SubdomainRecord(subdomain=1, newton_steps=0, residual=0.0, sweeps=5),
    ]
    assert work(PAPER.grid, SUBDOMAINS, records, 0) == 14 * 20 * (3 + 5)
    assert work(PAPER.grid, SUBDOMAINS, records, 2) == 14 * 20 * (3 + 5) + 2 * 24 * 20


def test_each_strip_receives_two_coordinates_of_a_line_and_the_nodes_of_its_overlap() -> None:
    data, nodes = 2 * (2 * 20), 2 * (4 * 20)  # of the four columns that both have, the first belongs to the first strip
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0, 1]], 0) == 8 * (data + nodes)
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0], [1]], 0) == 8 * (data + nodes)
    there_and_back = 8 * (data + 2 * 20 + nodes + 2 * 1 * 20)
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0], [1], [0]], 0) == there_and_back


def test_a_line_correction_takes_one_line_of_nodes_and_two_numbers_of_each_line_both_ways() -> None:
    without = traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0, 1]], 0)
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0, 1]], 3) == without + 3 * 8 * 2 * (2 * 20 + 2 * 20)


def test_a_robin_condition_sends_classical_data_too_and_reads_one_line_more() -> None:
    robin = em.Schwarz(transmission=em.LinearRobin(), subdomains=(2, 1), overlap=4)
    subdomains = subdomains_of(PAPER, InOneProcess(STRIPS), robin, enough=0.0, threads=1)
    assert traffic(STRIPS, robin, subdomains, [[0, 1]], 0) == 8 * (2 * (4 * 20) + 2 * (6 * 20))


def test_an_optimized_condition_sends_a_sum_for_each_line() -> None:
    optimized = em.Schwarz(subdomains=(2, 1), overlap=4)
    subdomains = subdomains_of(PAPER, InOneProcess(STRIPS), optimized, enough=0.0, threads=1)
    assert traffic(STRIPS, optimized, subdomains, [[0, 1]], 0) == 8 * (2 * 20 + 2 * (6 * 20))
