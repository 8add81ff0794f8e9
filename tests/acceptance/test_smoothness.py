"""The barrier holds without a tremor, comes as near as it may, and is hardly slower than the quickest stop."""

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

from workgauge.guard.registry import guard_named

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
pytestmark = pytest.mark.prove


@pytest.fixture
def benchmark():  # type: ignore[no-untyped-def]
    """Import a benchmark by its name."""
    sys.path.insert(0, str(BENCHMARKS))
    yield importlib.import_module
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize("joints", ["ideal", "hydraulic"])
@pytest.mark.parametrize("scene", ["slide-along-envelope", "between-limits"])
def test_a_tenth_of_the_potential_field_s_chatter_and_less_than_the_nearest_pair_s(
    benchmark: Any, scene: str, joints: str
) -> None:
    rows = benchmark("chatter").measure([scene], [joints], ["potential", "nearest-pair", "barrier"])["rows"]
    barrier = next(row for row in rows if row["guard"] == "barrier")
    assert barrier["entries"] == 0
    assert barrier["min_clearance_m"] >= 0.2
    assert barrier["share_of_potential"] <= 0.1
    assert barrier["share_of_nearest_pair"] < 1.0


def test_it_comes_within_2_cm_and_takes_at_most_a_quarter_longer_than_the_time_optimal_stop(benchmark: Any) -> None:
    approach = benchmark("approach")
    for row in approach.measure(approach.KINDS, [guard_named("barrier")])["rows"]:
        assert 0.0 <= row["left_m"] <= 0.02
        assert row["delayed_least_m"] >= 0.0
        assert row["ratio"] <= 1.25
