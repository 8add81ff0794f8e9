"""Property tests draw anew on every machine but the one that decides what lands: there, the same every time."""

import os

import pytest
from hypothesis import settings

settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")


@pytest.fixture(scope="session")
def pseudo_terminals() -> None:
    """Skip where the machine has no pseudo-terminals to stand for serial ports."""
    try:
        ends = os.openpty()
    except (AttributeError, OSError) as error:
        pytest.skip(f"no pseudo-terminals on this machine: {error}")
    for end in ends:
        os.close(end)
