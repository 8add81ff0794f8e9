"""Arguments: several files after one option."""

import pytest

from workgauge.app.output import spread


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (["--site", "a", "b", "c"], ["--site", "a", "--site", "b", "--site", "c"]),
        (["--site", "a", "--site", "b"], ["--site", "a", "--site", "b"]),
        (["--site", "a", "b", "--at", "1,2,3"], ["--site", "a", "--site", "b", "--at", "1,2,3"]),
        (["--headless", "--site", "a", "b", "--json"], ["--headless", "--site", "a", "--site", "b", "--json"]),
        (["--at", "-1,2,3", "--site", "a"], ["--at", "-1,2,3", "--site", "a"]),
        (["--site=a", "--json"], ["--site=a", "--json"]),
        (["--site"], ["--site"]),
        (["--site", "--json"], ["--site", "--json"]),
        ([], []),
    ],
)
def test_site_takes_several_values(args: list[str], expected: list[str]) -> None:
    assert spread("--site", args) == expected
