"""What pages cost the tick, and how long a hand's motion takes to the valves. Prints JSON.

One machine ticks in this process as the cockpit's does. Blocks of two kinds alternate in one run, so that what else
the computer does falls on both: driven by a joystick box's program straight over the bus with no page open, and
driven from a page through the page's real server with `--pages` web sockets open, one of them reading nothing. Both
send thirty hands a second, each told from the others by its lever, which stays in the dead zone: the tick has the
same work to do. Programs that send and read run before the first block and do nothing in turn. Beside the tick's time
on the clock, which counts whatever else the processor does meanwhile, stands the processor's time it took itself. The
latency is from before the page's web socket to after the tick that used it.

    python benchmarks/cockpit.py --json
"""

import argparse
import asyncio
import contextlib
import json
import multiprocessing
import statistics
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from workgauge.app.cockpit_processes import Plan, free_port, page_process, prefer, prefer_tick
from workgauge.bus.pace import Pace
from workgauge.bus.zenoh_mail import ZenohMail
from workgauge.cockpit.access import Access
from workgauge.rehearse import session as session_module
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.station.desk import DeskSettings
from workgauge.rehearse.station.running import run_station
from workgauge.rehearse.station.station import Station
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp
from workgauge.values.station import Request, RequestKind
from workgauge.wire.messages import encode
from workgauge.wire.station import encode_station, topic

#: Lever values tell hands apart; all of them lie in the dead zone.
STEP, MOST = 1e-5, 4000
PERIOD_S = 1 / 30
stepping: Any = session_module  # its tick is timed from inside
#: Until whoever drives next has the seat, and Enable pressed [s].
SETTLE_S = 1.0


def pages(port: int, count: int, wish: Any, done: Any) -> None:
    """Open pages when told to, drive from the first, read in all but the last; tell when each hand was sent."""
    from websockets.asyncio.client import connect

    numbers = iter(range(1, MOST))

    async def one(k: int, opened: list[int], sent: list[tuple[int, int]]) -> None:
        address = f"ws://127.0.0.1:{port}/link"
        origin: Any = f"http://127.0.0.1:{port}"
        async with connect(address, origin=origin, proxy=None, close_timeout=0.2) as socket:
            opened.append(k)
            if k == count - 1 and count > 1:
                await asyncio.sleep(3600.0)  # reads nothing
            seen = [0]
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(read(socket, seen))
                if k == 0:
                    tasks.create_task(drive(socket, seen, sent))

    async def read(socket: Any, seen: list[int]) -> None:
        async for text in socket:
            said = json.loads(text)
            if said["say"] == "snapshot":
                seen[0] = said["is"]["number"]
                await socket.send(json.dumps({"say": "seen", "n": seen[0]}))

    async def drive(socket: Any, seen: list[int], sent: list[tuple[int, int]]) -> None:
        while not seen[0]:
            await asyncio.sleep(0.02)
        await socket.send(json.dumps({"say": "ask", "seen": 0, "id": "1", "kind": "take"}))
        for i, n in enumerate(numbers):
            hands = {"say": "hands", "n": n, "seen": seen[0], "mode": "joint", "levers": [n * STEP, 0, 0, 0, 0, 0]}
            sent.append((n, time.monotonic_ns()))
            await socket.send(json.dumps(hands | {"enable": i > 5}))
            await asyncio.sleep(PERIOD_S)

    async def block() -> list[tuple[int, int]]:
        opened: list[int] = []
        sent: list[tuple[int, int]] = []
        tasks = [asyncio.create_task(one(k, opened, sent)) for k in range(count)]
        while len(opened) < count:
            await asyncio.sleep(0.02)
        done.put("open")
        await asyncio.to_thread(wish.get)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return sent

    with contextlib.suppress(EOFError, OSError):
        done.put("ready")
        while wish.get() == "open":
            done.put(asyncio.run(block()))


def box(plan: Plan, wish: Any, done: Any) -> None:
    """Drive as a joystick box does, straight over the bus, when told to."""
    mail = ZenohMail(connect=plan.bus("page")["connect"])
    name, count = plan.machine_id, 0
    with contextlib.suppress(EOFError, OSError):
        done.put("ready")
        while wish.get() == "open":
            stamp = Stamp(name, time.monotonic_ns(), f"box {count}")
            mail.publish(topic(name, "request"), encode_station(Request(stamp, "1", RequestKind.TAKE)))
            done.put("open")
            i = 0
            while wish.empty():
                count, i = count + 1, i + 1
                intent = Intent(
                    Stamp(name, time.monotonic_ns(), stamp.source), DriveMode.JOINT, Levers(count * STEP), i > 5
                )
                mail.publish(topic(name, "intent"), encode(intent, count))
                time.sleep(PERIOD_S)
            wish.get()
            done.put([])
    mail.close()


def quantiles(values: list[float]) -> dict[str, float]:
    """Return median and 99th percentile."""
    ordered = sorted(values)
    return {"median": round(statistics.median(ordered), 4), "p99": round(ordered[int(0.99 * (len(ordered) - 1))], 4)}


@dataclass
class Ticks:
    """What ticks took in one kind of block [ms]."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    late: int = 0
    enabled: int = 0


class Bench:
    """A machine that ticks, and programs that drive it in turn."""

    def __init__(self, count: int) -> None:
        prefer()
        self.station = Station(load_scenario("pole-approach").choosing(guard="barrier"), DeskSettings())
        self.session = self.station.session
        access = Access("127.0.0.1", free_port(), None)
        self.plan = Plan.of(self.station._loaded, DeskSettings(), access, self.session.machine_id)
        self.mail = ZenohMail(**self.plan.bus("machine"))
        self._context = multiprocessing.get_context("spawn")
        ready = self._context.Event()
        self._others = [self._begin(page_process, self.plan, ready)]
        ready.wait(60)
        self.found = {"alone": Ticks(), "pages": Ticks()}
        self.latencies: list[float] = []
        self._speaks = {}
        for name, run, first in (("alone", box, (self.plan,)), ("pages", pages, (access.port, count))):
            wish, done = self._context.Queue(), self._context.Queue()
            self._others.append(self._begin(run, *first, wish, done))
            self._speaks[name] = wish, done
            done.get(timeout=60.0)
        self._used: dict[int, int] = {}
        self._note: Ticks | None = None
        self._cpu_ms, self._late = 0.0, 0
        self.session.observe(self._observe)

    def _begin(self, run: Any, *given: Any) -> Any:
        process = self._context.Process(target=run, args=given, daemon=True)
        process.start()
        return process

    def _observe(self, inputs: Any, _frame: bytes, _trace: Any) -> None:
        if inputs.intent is not None:
            self._used.setdefault(round(inputs.intent.levers.left_x / STEP), time.monotonic_ns())

    def run(self, seconds: float, turns: int) -> None:
        """Measure so many blocks of each kind in one run of the station's own loop, after one of each to warm up."""
        pace, script = Pace(self.session.tick_s), self._script(seconds, turns)
        tick, step = stepping.tick, self.session.step

        def timed_tick(*given: Any) -> Any:
            began = time.thread_time_ns()
            done = tick(*given)
            self._cpu_ms = (time.thread_time_ns() - began) * 1e-6
            return done

        def timed(*given: Any) -> Any:
            done = step(*given)
            if self._note is not None:
                self._note.wall.append(done.tick_ms)
                self._note.cpu.append(self._cpu_ms)
                self._note.enabled += self.session.gate_open
                self._note.late += pace.late - self._late
            self._late = pace.late
            return done

        stepping.tick, self.session.step = timed_tick, timed  # type: ignore[method-assign]
        prefer_tick()
        try:
            run_station(self.station, self.mail, pace, lambda: next(script, False))
        finally:
            stepping.tick, self.session.step = tick, step  # type: ignore[method-assign]

    def _script(self, seconds: float, turns: int) -> Iterator[bool]:
        """Open and close pages and box in turn, one call a tick."""
        for turn in range(-1, turns):
            for name in ("alone", "pages") if turn % 2 else ("pages", "alone"):
                wish, done = self._speaks[name]
                self.station.desk.seat("", time.monotonic_ns())
                self._used.clear()
                wish.put("open")
                while done.empty():
                    yield True
                done.get()
                until = time.monotonic() + SETTLE_S  # takes the seat, presses enable
                while time.monotonic() < until:
                    yield True
                self._note = self.found[name] if turn >= 0 else None
                until = time.monotonic() + seconds
                while time.monotonic() < until:
                    yield True
                self._note = None
                wish.put("close")
                while done.empty():
                    yield True
                sent = done.get()
                if turn >= 0:
                    self.latencies += [(self._used[n] - at) * 1e-6 for n, at in sent if n in self._used]

    def end(self) -> None:
        """End all."""
        for one in self._others:
            one.terminate()
        self.mail.close()


def measured(count: int, seconds: float, turns: int) -> dict[str, Any]:
    """Return what pages cost."""
    bench = Bench(count)
    bench.run(seconds, turns)
    bench.end()
    alone, with_pages = bench.found["alone"], bench.found["pages"]

    def ratios(what: str) -> dict[str, float]:
        before, after = quantiles(getattr(alone, what)), quantiles(getattr(with_pages, what))
        return {name: round(after[name] / before[name], 3) for name in before}

    return {
        "pages": count,
        "seconds": seconds * turns,
        "tick_ms": {name: quantiles(one.wall) for name, one in bench.found.items()},
        "tick_cpu_ms": {name: quantiles(one.cpu) for name, one in bench.found.items()},
        "ratio": ratios("wall"),
        "cpu_ratio": ratios("cpu"),
        "ticks": {name: len(one.wall) for name, one in bench.found.items()},
        "late_ticks": {name: one.late for name, one in bench.found.items()},
        "enabled_ticks": {name: one.enabled for name, one in bench.found.items()},
        "key_to_command_ms": quantiles(bench.latencies) if bench.latencies else None,
        "hands": len(bench.latencies),
        "tick_period_ms": bench.session.tick_s * 1e3,
        "refused": {k: getattr(bench.station.desk.heard, k) for k in bench.station.desk.heard.__slots__},
    }


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--pages", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--turns", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    threading.current_thread().name = "machine"
    found = measured(given.pages, given.seconds, given.turns)
    print(json.dumps(found, indent=None if given.json else 2))


if __name__ == "__main__":
    main()
