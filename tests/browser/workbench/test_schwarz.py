"""The panel of the Schwarz iteration: every setting is reachable, and the service takes it."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from browser.workbench.panels import answered, fault_of, panel, set_number, spec_of
from equimesh_schema import schwarz

pytestmark = pytest.mark.needs("chromium")


def test_the_iteration_is_switched_on_and_off_with_its_settings_kept(page: Page) -> None:
    box = panel(page, "schwarz")
    switch = box.get_by_label("Divide into subdomains")
    answer = answered(page, switch.check)
    assert answer.status == 200, answer.text()
    assert spec_of(page)["schwarz"] == {}
    set_number(box, "subdomains along xi", 3)
    set_number(box, "along eta", 2)
    switch.uncheck()
    assert "schwarz" not in spec_of(page)
    expect(box.get_by_label("Overlap in points")).to_be_hidden()
    switch.check()
    assert spec_of(page)["schwarz"] == {"subdomains": [3, 2]}


def test_every_setting_is_reachable_and_taken(page: Page) -> None:
    box = panel(page, "schwarz")
    box.get_by_label("Divide into subdomains").check()
    condition = box.get_by_label("Transmission condition")
    for kind, use in [(kind, made.USE) for kind, made in schwarz.TRANSMISSIONS.documents.items()]:
        condition.select_option(kind)
        expect(box.get_by_text(use)).to_be_visible()
    assert spec_of(page)["schwarz"]["transmission"] == {"kind": "nonlinear_robin"}
    box.get_by_label("Parameter p", exact=True).select_option("number")
    set_number(box, "Parameter p, a number", 3)
    set_number(box, "Overlap in points", 3)
    box.get_by_label("Ordering").select_option("alternating")
    box.get_by_label("Line corrections", exact=True).select_option("number")
    set_number(box, "Line corrections, a number", 2)
    box.get_by_label("Acceleration").select_option("none")
    box.get_by_label("Local solver").select_option("newton")
    box.get_by_label("Fall back").uncheck()
    set_number(box, "Tolerance, a number", 1e-6)
    set_number(box, "Most iterations", 40)
    answer = answered(page, box.get_by_label("Compare with the single domain").check)
    assert answer.status == 200, answer.text()
    assert spec_of(page)["schwarz"] == {
        "transmission": {"kind": "nonlinear_robin", "p": 3},
        "overlap": 3,
        "ordering": "alternating",
        "line_correction": 2,
        "acceleration": "none",
        "local_solver": "newton",
        "fallback": False,
        "tolerance": 1e-6,
        "max_iterations": 40,
        "compare_single_domain": True,
    }


def test_subdomains_of_least_error_have_steps_and_exchanges(page: Page) -> None:
    panel(page, "monitor").get_by_label("Kind", exact=True).select_option("least_error")
    box = panel(page, "schwarz")
    box.get_by_label("Divide into subdomains").check()
    set_number(box, "For least error: steps in one exchange", 4)
    box.get_by_label("For least error: most exchanges", exact=True).select_option("number")
    answer = answered(page, lambda: set_number(box, "For least error: most exchanges, a number", 3))
    assert answer.status == 200, answer.text()
    assert spec_of(page)["schwarz"] == {"local_steps": 4, "max_exchanges": 3}
    box.get_by_label("For least error: most exchanges", exact=True).select_option("")
    assert spec_of(page)["schwarz"] == {"local_steps": 4}


def test_a_tolerance_may_be_a_word_or_nothing(page: Page) -> None:
    box = panel(page, "schwarz")
    box.get_by_label("Divide into subdomains").check()
    tolerance = box.get_by_label("Tolerance", exact=True)
    tolerance.select_option("discretization")
    assert spec_of(page)["schwarz"] == {"tolerance": "discretization"}
    tolerance.select_option("")
    assert spec_of(page)["schwarz"] == {"tolerance": None}
    tolerance.select_option("number")
    assert spec_of(page)["schwarz"] == {}
    box.get_by_label("Transmission condition").select_option("optimized")
    box.get_by_label("Data of an interface").select_option("local")
    assert spec_of(page)["schwarz"] == {"transmission": {"kind": "optimized", "data": "local"}}


def test_a_fault_is_shown_at_its_field(page: Page) -> None:
    box = panel(page, "schwarz")
    box.get_by_label("Divide into subdomains").check()
    field = box.get_by_label("Overlap in points")
    field.fill("1")
    expect(fault_of(field)).to_contain_text("2")
