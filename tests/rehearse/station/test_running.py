"""The loop goes on whatever cannot be told, and tells what can."""

import weakref
from dataclasses import replace

import pytest

from workgauge.bus.memory_mail import MemoryMail, MemoryPost
from workgauge.rehearse.station.running import run_station
from workgauge.values.station import RequestKind
from workgauge.wire.station import decode_station, topic


class Ticks:
    """A period that passes at once, so many times."""

    late = 0

    def __init__(self, count: int, tick_s: float) -> None:
        self._left, self._step_ns, self._now_ns = count, round(tick_s * 1e9), 0

    def wait(self) -> int:
        self._left -= 1
        self._now_ns += self._step_ns
        return self._now_ns

    def going(self) -> bool:
        return self._left > 0


@pytest.mark.parametrize("broken", ["setup", "snapshot"])
def test_what_cannot_be_written_is_said_once_and_the_machine_goes_on(
    bench, broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    station, post = bench.station, MemoryPost()
    reader = MemoryMail(post)
    heard = {name: reader.inbox(topic(station.session.machine_id, name), 100) for name in ("setup", "snapshot")}
    if broken == "setup":
        made = station.setup
        monkeypatch.setattr(station, "setup", lambda now_ns: replace(made(now_ns), title="x" * 70_000))
    else:
        shown = station._snapshot
        monkeypatch.setattr(station, "_snapshot", lambda *given: replace(shown(*given), scale=float("nan")))
    ticks = Ticks(250, station.session.tick_s)
    run_station(station, MemoryMail(post), ticks, ticks.going)
    assert station.session.t_s == pytest.approx(250 * station.session.tick_s)
    letters = {name: inbox.read() for name, inbox in heard.items()}
    assert not letters.pop(broken)
    assert all(decode_station(one.data, 0) for one in letters.popitem()[1])
    assert [event.text.startswith(f"the {broken} cannot be told") for event in station.told.events] == [True]


def test_putting_it_back_leaves_nothing_of_the_machine_that_was(bench) -> None:
    station, post = bench.station, MemoryPost()
    machine_id, hand = station.session.machine_id, MemoryMail(post)
    gone, alive = [], []

    class Restarts(Ticks):
        def wait(self) -> int:
            if self._left in (30, 20, 10):
                gone.append(weakref.ref(station.session.scene))
                hand.publish(topic(machine_id, "request"), bench.frame(RequestKind.RESTART))
            if self._left == 1:
                alive.extend(one() is not None for one in gone)
            return super().wait()

    ticks = Restarts(40, station.session.tick_s)
    bench.ask(RequestKind.TAKE)
    bench.step()
    run_station(station, MemoryMail(post), ticks, ticks.going)
    # the first one was there before the loop was: it is kept apart from what is collected
    assert alive[1:] == [False, False]
