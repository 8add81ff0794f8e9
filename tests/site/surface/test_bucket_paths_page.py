"""The example of docs/bucket_paths.md runs as it stands."""

import doctest
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "bucket_paths.md"


def test_the_example_runs() -> None:
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried >= 8 and not failed
