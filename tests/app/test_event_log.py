"""The log never holds up who logs, loses nothing it can write, and says what it lost."""

import io
import threading
from datetime import UTC, datetime

from hypothesis import given
from hypothesis import strategies as st

from workgauge.app.event_log import WAITING, EventLog

NOON = datetime(2026, 5, 4, 12, 0, 0, 250_000, UTC)


class Stuck(io.StringIO):
    """A terminal that was stopped."""

    def __init__(self) -> None:
        super().__init__()
        self.go_on = threading.Event()

    def write(self, text: str) -> int:
        self.go_on.wait(10.0)
        return super().write(text)


@given(st.lists(st.text(st.characters(exclude_categories=("Cc", "Zl", "Zp", "Cs")), max_size=20), max_size=30))
def test_every_line_arrives_in_order_with_its_time(lines: list[str]) -> None:
    sinks = [io.StringIO(), io.StringIO()]
    log = EventLog(sinks, lambda: NOON)
    for line in lines:
        log(line)
    log.close()
    for sink in sinks:
        assert sink.getvalue() == "".join(f"2026-05-04T12:00:00.250Z {line}\n" for line in lines)


def test_a_stopped_terminal_holds_nobody_up_and_what_is_lost_is_counted() -> None:
    stuck = Stuck()
    log = EventLog([stuck], lambda: NOON)
    for i in range(WAITING + 500):
        log(str(i))  # would wait for ever
    stuck.go_on.set()
    while log._waiting.qsize():
        pass
    log("last")
    log.close()
    said = stuck.getvalue().splitlines()
    lost = [int(line.split()[0].strip("(")) for line in said if line.endswith("lines lost)")]
    assert sum(lost) > 0
    assert len(said) - len(lost) + sum(lost) == WAITING + 500 + 1
    assert said[-1].endswith("last")


def test_a_sink_that_fails_leaves_the_others_alone() -> None:
    gone, good = io.StringIO(), io.StringIO()
    gone.close()
    log = EventLog([gone, good], lambda: NOON)
    log("a")
    log("b")
    log.close()
    assert [line[-1] for line in good.getvalue().splitlines()] == ["a", "b"]
