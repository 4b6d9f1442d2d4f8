"""The findings of checks."""

from __future__ import annotations

from equimesh_cli.checks.installation import Level, failed, ok, warning


def test_levels_get_worse_in_their_order() -> None:
    findings = [ok("works"), warning("works with a fault", "mend it"), failed("does not work")]
    assert [finding.level for finding in findings] == list(Level) == ["ok", "warning", "failed"]
    assert [finding.remedy for finding in findings] == ["", "mend it", ""]
    assert findings[2].message == "does not work"
