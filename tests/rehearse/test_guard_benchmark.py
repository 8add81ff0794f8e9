"""The guards' benchmark: what its rows mean, and a journal that survives a crash."""

import importlib
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from workgauge.guard.api import GuardInput
from workgauge.rehearse.drives.run import DriveResult
from workgauge.rehearse.drives.watch import Nearest
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.clearances import Clearances

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
PLAIN = DriveResult(
    *(0, "levers", "somewhere", "linear", 0, ()),
    *(0.5, 0.3, (Nearest("track", "boom", "track:1", 0.5, 0.3),), 1.0, 4.0, True, 200, 2, 0.1),
)


@pytest.fixture(scope="module", autouse=True)
def beside():
    """Benchmarks import each other by name."""
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def benchmark(beside):
    pytest.importorskip("daqp")
    spec = importlib.util.spec_from_file_location("guard_benchmark", BENCHMARKS / "guard.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def given(distances, rows, desired, stops=None):
    """A guard's input with these clearances (k), rows (k, n) and wish (n)."""
    k, n = len(distances), len(desired)
    none, vectors = frozen(np.zeros(k)), frozen(np.zeros((k, 3)))
    index = frozen_ints(np.zeros(k))
    clearances = Clearances(
        *(frozen(distances), vectors, vectors, vectors, index, frozen_ints(np.full(k, -1)), index, index, index),
        *(none, frozen(np.full(k, math.nan) if stops is None else stops), ("arm",), ("pole",), 9.0),
    )
    ends, fast = frozen(np.full(n, math.inf)), frozen(np.ones(n))
    names = tuple(f"j{j}" for j in range(n))
    return GuardInput(
        *(frozen(desired), frozen(np.zeros(n)), -ends, ends, fast, fast, clearances, frozen(rows), 0.02, names, ())
    )


def test_rows_count_entries_and_compare_motion_only_where_linear_scaling_holds(benchmark):
    here = ("equal", 0.3)
    results = {
        ("linear", *here, 0): PLAIN,
        ("linear", *here, 1): replace(PLAIN, seed=1, entries=2, worst_clearance_m=-0.1, worst_less_stop_m=-0.3),
        ("linear", *here, 2): replace(PLAIN, seed=2, worst_clearance_m=0.1, worst_less_stop_m=-0.1),
        ("linear", *here, 3): replace(PLAIN, seed=3, motion=3.0),
        ("bands", *here, 0): replace(PLAIN, guard="bands", motion=0.5),
        ("bands", *here, 1): replace(PLAIN, guard="bands", seed=1, motion=9.0),
        ("bands", *here, 2): replace(PLAIN, guard="bands", seed=2, motion=9.0),
        ("bands", *here, 3): replace(PLAIN, guard="bands", seed=3, motion=2.5),
    }
    linear, bands = benchmark.rows(results)
    assert (linear["entries"], linear["drives_entered"], linear["below_stop"], linear["holds"]) == (2, 1, 2, 2)
    assert (linear["worst_clearance_m"], linear["worst_less_stop_m"]) == (-0.1, -0.3)
    assert linear["holds_motion_ratio"] == 1.0
    assert bands["holds_motion_ratio"] == pytest.approx(3.0 / 4.0)
    assert bands["motion_rad"] == 21.0
    assert bands["motion_share"] == pytest.approx(21.0 / 16.0)
    assert linear["seeds_below_stop"] == [1, 2]
    nothing = benchmark.rows({("bands", *here, 0): replace(PLAIN, worst_clearance_m=math.inf)})[0]
    assert (nothing["worst_clearance_m"], nothing["holds"], nothing["holds_motion_ratio"]) == (None, None, None)


def test_a_journal_gives_back_what_is_whole_and_goes_on_after_a_line_cut_off(benchmark, tmp_path):
    journal, path = benchmark.Journal(tmp_path / "runs.jsonl"), tmp_path / "runs.jsonl"
    keys = [("linear", "equal", 0.3, seed) for seed in range(4)]
    assert journal.known(set(keys)) == {}
    journal.append((key, replace(PLAIN, seed=key[3]).plain()) for key in keys[:2])
    assert journal.known(set(keys)) == {key: replace(PLAIN, seed=key[3]) for key in keys[:2]}
    path.write_bytes(path.read_bytes()[:-30])
    assert set(journal.known(set(keys))) == {keys[0]}
    journal.append([(keys[2], replace(PLAIN, seed=2).plain())])
    assert set(journal.known(set(keys))) == {keys[0], keys[2]}
    assert set(journal.known({keys[2]})) == {keys[2]}
    lines = [line.replace('"settings": "', '"settings": "of other drives ') for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    assert journal.known(set(keys)) == {}


def test_settings_differ_in_what_a_journal_is_marked_with(benchmark):
    marks = {benchmark.fingerprint(kind, dead) for kind in benchmark.DYNAMICS for dead in benchmark.DEAD_TIMES_S}
    assert len(marks) == len(benchmark.DYNAMICS) * len(benchmark.DEAD_TIMES_S)
    assert benchmark.settings("equal", 0.3).dynamics.tolerance == 0.0
    assert benchmark.settings("tolerance", 0.3).dynamics.truth == "within"


def test_every_guard_keeps_the_stop_distance_of_the_drives(benchmark):
    for name in (*benchmark.GUARDS, *benchmark.BASELINES):
        assert benchmark.guard_made(name).name == name
        if name != "none":
            assert benchmark.guard_made(name).stop_distance_m == benchmark.STOP_DISTANCE_M


@pytest.mark.parametrize(("slack", "scale"), [(0.7, 1.0), (0.6, 1.0), (0.3, 0.001**0.5), (1e-9, 0.001), (-0.1, 0.0)])
def test_one_scale_slows_every_direction_alike(benchmark, slack, scale):
    guard = benchmark.guard_made("one-scale")
    for sign in (1.0, -1.0):
        wish = given([0.2 + slack], [[1.0, 0.5]], [sign, 0.4])
        result, _ = guard.allow(wish, guard.start())
        assert result.allowed == pytest.approx(np.array([sign, 0.4]) * scale, rel=1e-6)


def test_bands_creep_and_stop_the_approaching_joint_alone(benchmark):
    guard = benchmark.guard_made("bands")
    for slack, left in ((1.2, -1.0), (0.5, -0.25), (0.05, 0.0)):
        result, _ = guard.allow(given([0.2 + slack], [[1.0, 1.0]], [-1.0, 0.8]), guard.start())
        assert result.allowed.tolist() == [left, 0.8]


def test_the_nearest_pair_alone_is_kept_and_no_other(benchmark):
    guard = benchmark.guard_made("nearest-pair")
    wish = given([0.26, 0.27], [[1.0, 0.0], [0.0, 1.0]], [-1.0, -1.0])
    result, _ = guard.allow(wish, guard.start())
    assert result.allowed == pytest.approx([-0.06 / 0.6, -1.0], abs=1e-6)
    own = replace(wish.clearances, stop_distances=frozen([0.0, math.nan]))
    result, _ = guard.allow(replace(wish, clearances=own), guard.start())
    assert result.allowed == pytest.approx([-1.0, -0.07 / 0.6], abs=1e-6)


def test_a_result_is_one_line_of_json(benchmark):
    assert DriveResult.of_plain(json.loads(json.dumps(PLAIN.plain()))) == PLAIN
