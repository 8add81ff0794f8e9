"""A fixed period that never runs after what it missed."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from workgauge.bus.pace import Pace

PERIOD = 10_000_000


class Clock:
    def __init__(self) -> None:
        self.now = 0

    def __call__(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


def test_periods_are_exact_where_the_work_is_short() -> None:
    clock = Clock()
    pace = Pace(0.01, clock=clock, sleep=clock.sleep)
    begun = []
    for work in (1_000_000, 9_000_000, 0, 5_000_000):
        begun.append(pace.wait())
        clock.now += work
    assert begun == [0, PERIOD, 2 * PERIOD, 3 * PERIOD]
    assert pace.late == 0


@given(st.lists(st.integers(0, 5 * PERIOD), min_size=1, max_size=30))
def test_never_two_periods_at_once_after_a_long_one(works: list[int]) -> None:
    clock = Clock()
    pace = Pace(0.01, clock=clock, sleep=clock.sleep)
    begun = []
    for work in works:
        begun.append(pace.wait())
        clock.now += work
    gaps = [b - a for a, b in itertools.pairwise(begun)]
    assert all(gap >= work for gap, work in zip(gaps, works, strict=False))
    # over any stretch, at most one period is made up for
    for i, first in enumerate(begun):
        assert all(later - first >= (j - 1) * PERIOD for j, later in enumerate(begun[i:]))
    assert pace.late == sum(1 for work in _late(works))


def _late(works: list[int]) -> list[int]:
    """Which works made the next period begin more than one period late, by a slower account."""
    now = due = 0
    found = []
    for i, work in enumerate(works):
        if now < due:
            now = due
        elif now - due > PERIOD:
            found.append(i)
            due = now
        due += PERIOD
        now += work
    return found
