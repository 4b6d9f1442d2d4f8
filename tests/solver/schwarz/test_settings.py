"""Settings of the Schwarz iteration: what is refused."""

from __future__ import annotations

import pytest

import equimesh as em


@pytest.mark.parametrize(
    ("more", "field"),
    [({"ordering": "alternating"}, "schwarz.ordering"), ({"line_correction": 1}, "schwarz.line_correction")],
)
def test_newton_is_refused_where_its_derivative_is_not_known(more: dict[str, object], field: str) -> None:
    with pytest.raises(em.InputError, match="newton") as caught:
        em.Schwarz(acceleration="newton", **more)
    assert caught.value.field == field


def test_lines_at_which_subdomains_meet_take_the_place_of_their_number() -> None:
    given = em.Schwarz(subdomains=([8, 17], 2))  # type: ignore[arg-type]
    assert given == em.Schwarz(subdomains=((8, 17), 2))
    assert given.counts == (3, 2)
    cut = given.decompose(em.Grid(n_xi=33, n_eta=21))
    assert [span.owned_first for span in cut.spans[0]] == [0, 8, 17]
    assert cut.spans[1] == em.Schwarz(subdomains=(1, 2)).decompose(em.Grid(n_xi=33, n_eta=21)).spans[1]
