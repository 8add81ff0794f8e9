"""The example on the machines page runs as it stands there."""

import doctest
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "machines.md"


def test_the_example_runs() -> None:
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried >= 5 and not failed


def test_the_figures_are_there() -> None:
    text = PAGE.read_text()
    for name in ("rre20", "sun-a", "brokk5"):
        assert f"(machines/{name}.svg)" in text and (PAGE.parent / "machines" / f"{name}.svg").exists()
