"""The cluttered scenes' benchmark: what its summary counts, and a journal that survives a crash."""

import importlib.util
import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark():
    """Benchmarks import each other by name."""
    pytest.importorskip("ompl")
    sys.path.insert(0, str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("cluttered_benchmark", BENCHMARKS / "cluttered.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture
def solved(benchmark):
    return benchmark.Outcome(True, "", 2.0, duration_s=6.0, kept_m=0.06, straight_s=3.0)


def test_what_is_counted(benchmark, solved):
    found = {
        0: solved,
        1: replace(solved, straight=True, seconds=0.01, duration_s=3.0),
        2: replace(solved, kept_m=0.049, seconds=4.0, duration_s=9.0, entered=True),
        3: benchmark.Outcome(False, "no way found", 60.0, hurried=True, straight_s=1.0),
    }
    told = benchmark.summary("global plan", found)
    counted = [told[name] for name in ("solved", "straight", "invalid", "entered", "hurried")]
    assert counted == [3, 1, 1, 1, 1]
    assert told["unsolved"] == {3: "no way found"}
    assert told["seconds_median"] == 4.0 and told["longer_median"] == 2.5
    assert benchmark.summary("local", {2: found[2]})["invalid"] == 0
    assert benchmark.summary("local", {2: replace(solved, kept_m=-2e-4)})["invalid"] == 1
    nothing = benchmark.summary("global plan", {1: found[1]})
    assert math.isnan(nothing["seconds_median"]) and nothing["longer_median"] is None


def test_a_journal_gives_back_what_is_whole_and_goes_on_after_a_line_cut_off(benchmark, solved, tmp_path):
    path, marks = tmp_path / "runs.jsonl", {"global plan": "a", "local": "b"}
    journal, keys = benchmark.Journal(path, marks), [("local", seed) for seed in range(4)]
    assert journal.known(set(keys)) == {}
    journal.append((key, replace(solved, seconds=float(key[1]))) for key in keys[:2])
    assert journal.known(set(keys)) == {key: replace(solved, seconds=float(key[1])) for key in keys[:2]}
    path.write_bytes(path.read_bytes()[:-30])
    assert set(journal.known(set(keys))) == {keys[0]}
    journal.append([(keys[2], solved)])
    assert set(journal.known(set(keys))) == {keys[0], keys[2]}
    assert set(journal.known({keys[2]})) == {keys[2]}
    assert benchmark.Journal(path, marks | {"local": "c"}).known(set(keys)) == {}


def test_settings_differ_in_what_a_journal_is_marked_with(benchmark, monkeypatch):
    def marks():
        return {
            benchmark.fingerprint(machine, method, spacing_m)
            for machine in ("rre20", "brokk5")
            for method in benchmark.METHODS
            for spacing_m in (0.005, 0.01)
        }

    before = marks()
    assert len(before) == 12
    monkeypatch.setitem(benchmark.VERSIONS, "local", 99)
    assert len(marks() - before) == 4


def test_only_what_the_journal_lacks_is_measured(benchmark, solved, tmp_path, monkeypatch):
    asked = []

    def run(task):
        asked.append(task)
        return [((method, task[1]), replace(solved, seconds=9.0)) for method in task[2]]

    monkeypatch.setattr(benchmark.Worker, "run", run)
    methods = ("global plan", "local")
    journal = benchmark.Journal(tmp_path / "runs.jsonl", dict.fromkeys(methods, "a"))
    journal.append([(("local", 0), solved), (("local", 1), solved), (("global plan", 1), solved)])
    tasks = [("sun-a", seed, methods, 0.005) for seed in range(3)]
    found = benchmark.measured(tasks, journal, 1, benchmark.Console(file=sys.stderr))
    assert [(task[1], task[2]) for task in asked] == [(0, ("global plan",)), (2, methods)]
    assert len(found) == 6 and found["local", 0] == solved and found["local", 2].seconds == 9.0
    assert journal.known(set(found)) == found


def test_what_going_for_the_goal_solves_is_not_driven_again_for_what_comes_after(benchmark, solved, tmp_path):
    journal = benchmark.Journal(tmp_path / "runs.jsonl", dict.fromkeys(benchmark.METHODS, "a"))
    journal.append([(("local", 0), solved)])
    tasks = [("sun-a", 0, ("local", "local, then plan"), 0.005)]
    found = benchmark.measured(tasks, journal, 1, benchmark.Console(file=sys.stderr))
    assert found["local, then plan", 0] == solved
