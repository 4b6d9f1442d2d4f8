"""The alerts: valid, explained, and fired when they should be."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]


def alerts() -> dict[str, str]:
    """The expression of each alert, on one line."""
    (group,) = yaml.safe_load((ROOT / "deploy/alerts.yml").read_text())["groups"]
    return {rule["alert"]: " ".join(rule["expr"].split()) for rule in group["rules"]}


def test_every_alert_is_explained() -> None:
    page = (ROOT / "docs/how-to/observe.md").read_text().replace("\\|", "|")
    for name, expression in alerts().items():
        assert f"`{expression}`" in page, name
    assert any(expression.startswith("absent(up{") for expression in alerts().values())


@pytest.mark.needs("promtool")
def test_alerts_see_services_that_are_down_and_that_are_gone(tmp_path: Path) -> None:
    one, two = 'up{job="equimesh", instance="a"}', 'up{job="equimesh", instance="b"}'

    def alert(name: str, minute: int, **labels: str) -> dict[str, Any]:
        found = [rule for rule in rules if rule["alert"] == name]
        expected = {"exp_labels": {**found[0]["labels"], **labels}, "exp_annotations": found[0]["annotations"]}
        return {"alertname": name, "eval_time": f"{minute}m", "exp_alerts": [expected]}

    def none(name: str, minute: int) -> dict[str, Any]:
        return {"alertname": name, "eval_time": f"{minute}m", "exp_alerts": []}

    rules = yaml.safe_load((ROOT / "deploy/alerts.yml").read_text())["groups"][0]["rules"]
    down = [{"series": one, "values": "1x10 0x20"}]
    gone = [{"series": one, "values": "1x10 _x20"}]
    one_gone = [{"series": one, "values": "1x120"}, {"series": two, "values": "1x10 _x110"}]
    tests = [
        (down, [none("EquimeshDown", 9), alert("EquimeshDown", 20, job="equimesh", instance="a")]),
        (gone, [none("EquimeshGone", 9), none("EquimeshDown", 30), alert("EquimeshGone", 30, job="equimesh")]),
        (
            one_gone,
            [none("EquimeshReplicaGone", 9), alert("EquimeshReplicaGone", 40), none("EquimeshReplicaGone", 100)],
        ),
    ]
    cases = [{"interval": "1m", "input_series": series, "alert_rule_test": expected} for series, expected in tests]
    document = {"rule_files": [str(ROOT / "deploy/alerts.yml")], "evaluation_interval": "1m", "tests": cases}
    (tmp_path / "tests.yml").write_text(yaml.safe_dump(document))
    done = subprocess.run(["promtool", "test", "rules", "tests.yml"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
