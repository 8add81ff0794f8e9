"""A machine may say at what distance its own links stop before each other."""

from importlib import resources
from typing import Any

import pytest
import yaml

from workgauge.machine.description import json_schema
from workgauge.machine.load import load_machine, machine_from
from workgauge.values.errors import MachineError

SHIPPED = resources.files("workgauge") / "shipped" / "machines"
RRE20: dict[str, Any] = yaml.safe_load((SHIPPED / "rre20.yaml").read_text(encoding="utf-8"))


def test_left_out_it_is_the_guards_own() -> None:
    assert machine_from(RRE20).self_stop_distance_m is None
    assert "self_stop_distance_m" not in json_schema()["required"]


@pytest.mark.parametrize("stop", [0, 0.05, 1])
def test_it_comes_from_the_file(stop: float) -> None:
    assert machine_from({**RRE20, "self_stop_distance_m": stop}).self_stop_distance_m == stop


@pytest.mark.parametrize("stop", [-0.01, 1.01, float("nan"), float("inf"), "near", True])
def test_what_is_no_such_distance_is_refused(stop: object) -> None:
    with pytest.raises(MachineError, match="self_stop_distance_m"):
        machine_from({**RRE20, "self_stop_distance_m": stop})


def test_the_small_shipped_machines_have_one() -> None:
    stops = {name: load_machine(name).self_stop_distance_m for name in ("rre20", "brokk5", "sun-a", "sun-b")}
    assert stops == {"rre20": None, "brokk5": 0.05, "sun-a": 0.05, "sun-b": 0.05}
