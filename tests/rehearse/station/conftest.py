"""A station of the shipped scenario with a clock of its own, driven by hand."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.station.desk import DeskSettings
from workgauge.rehearse.station.station import Station
from workgauge.values.mail import Letter
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp
from workgauge.values.station import Answer, Request, RequestKind, Snapshot
from workgauge.wire.messages import encode
from workgauge.wire.station import encode_station

PAGE = "page-1"


@dataclass
class Bench:
    """Steps a station; says what pages say."""

    station: Station
    now_ns: int = 1_000_000_000
    snapshot: Snapshot | None = None
    count: Iterator[int] = field(default_factory=lambda: itertools.count(1))
    waiting: list[Letter] = field(default_factory=list)
    hands: list[Letter] = field(default_factory=list)

    @property
    def machine_id(self) -> str:
        return self.station.session.machine_id

    def stamp(self, source: str) -> Stamp:
        return Stamp(self.machine_id, self.now_ns, source)

    def ask(self, kind: RequestKind, source: str = PAGE, **rest: object) -> str:
        """Put a request into the mail and return its id."""
        name = str(next(self.count))
        self.waiting.append(Letter("request", self.now_ns, self.frame(kind, source, name, **rest)))
        return name

    def frame(self, kind: RequestKind, source: str = PAGE, name: str = "1", **rest: object) -> bytes:
        """Return a request as it is sent."""
        return encode_station(Request(self.stamp(source), name, kind, **rest))  # type: ignore[arg-type]

    def move(
        self, source: str = PAGE, *, enable: bool = True, mode: DriveMode = DriveMode.JOINT, **levers: float
    ) -> None:
        """Put an intent into the mail."""
        intent = Intent(self.stamp(source), mode, Levers(**levers), enable)
        self.hands.append(Letter("intent", self.now_ns, encode(intent, next(self.count))))

    def step(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            hands, self.hands = self.hands, []
            asked, self.waiting = self.waiting, []
            found = self.station.step(self.now_ns, hands, asked)
            self.snapshot = found or self.snapshot
            self.now_ns += round(self.station.session.tick_s * 1e9)

    def drive(self, ticks: int, source: str = PAGE, **levers: float) -> None:
        """Drive with a fresh intent at every tick."""
        for _ in range(ticks):
            self.move(source, **levers)  # type: ignore[arg-type]
            self.step()

    def seated(self, source: str = PAGE) -> None:
        """Take the seat, and open the gate."""
        self.ask(RequestKind.TAKE, source)
        self.step()
        self.move(source, enable=False)
        self.step()
        self.drive(2, source)
        assert self.station.session.gate_open

    def answer(self, name: str) -> Answer:
        return next(one for one in self.station.told.answers if one.id == name)

    @property
    def valves(self) -> tuple[int, ...]:
        done = self.station._done
        assert done is not None
        return done.trace.valves

    def now(self) -> Snapshot:
        """Step until the next snapshot."""
        self.snapshot = None
        while self.snapshot is None:
            self.step()
        return self.snapshot


@pytest.fixture
def bench() -> Bench:
    return Bench(Station(load_scenario("pole-approach").choosing(guard="barrier"), DeskSettings()))
