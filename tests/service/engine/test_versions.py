"""Which versions of service and worker fit together."""

from __future__ import annotations

import equimesh_service.engine.cluster_pool as module
from equimesh_service.engine.cluster_pool import describe_difference, versions


def test_this_process_fits_to_itself_and_names_what_differs() -> None:
    here = versions()
    assert describe_difference(here, versions()) == ""
    older = {**here, "equimesh": "0.1.0", "Python": "3.9.1"}
    expected = f"Python 3.9.1 in place of {here['Python']}, equimesh 0.1.0 in place of {here['equimesh']}"
    assert describe_difference(here, older) == expected
    assert describe_difference({"numpy": "2.1.0"}, {}) == "numpy none in place of 2.1.0"


def test_only_the_first_numbers_of_python_and_numpy_count() -> None:
    here = {"Python": "3.11.7", "numpy": "2.1.0", "distributed": "2026.8.0"}
    assert describe_difference(here, {**here, "Python": "3.11.9", "numpy": "2.1.3"}) == ""
    assert describe_difference(here, {**here, "distributed": "2026.8.1"}) != ""


def test_a_package_that_is_not_installed_has_no_version() -> None:
    assert module._version("no-such-package-at-all") == "none"
