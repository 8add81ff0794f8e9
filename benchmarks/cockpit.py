"""What pages cost the tick, and how long a hand's motion takes to the valves. Prints JSON.

One machine ticks in this process as the cockpit's does. In turn it runs alone and with pages: `--pages` web sockets
through the page's real server, one of them reading nothing. A driver's page sends thirty hands a second, each told
from the others by its lever; the latency is from before the page's web socket to after the tick that used it. Ticks
with and without pages alternate in one run, so that what else the computer does falls on both.

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
from typing import Any

from workgauge.app.cockpit_processes import Plan, free_port, page_process, prefer
from workgauge.bus.pace import Pace
from workgauge.bus.zenoh_mail import ZenohMail
from workgauge.cockpit.access import Access
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.station.desk import DeskSettings
from workgauge.rehearse.station.running import run_station
from workgauge.rehearse.station.station import Station

#: Lever values tell hands apart; all of them lie in the dead zone.
STEP, MOST = 1e-5, 4000


def pages(port: int, count: int, seconds: float, sent: Any) -> None:
    """Open pages, drive from the first, read in all but the last, for so long."""
    from websockets.asyncio.client import connect

    async def one(k: int) -> None:
        address = f"ws://127.0.0.1:{port}/link"
        async with connect(address, origin=f"http://127.0.0.1:{port}", proxy=None) as socket:  # type: ignore[arg-type]
            if k == count - 1 and count > 1:
                await asyncio.sleep(seconds)  # reads nothing
                return
            seen = [0]
            tasks = [asyncio.create_task(read(socket, seen))]
            if k == 0:
                tasks.append(asyncio.create_task(drive(socket, seen)))
            await asyncio.sleep(seconds)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def read(socket: Any, seen: list[int]) -> None:
        async for text in socket:
            said = json.loads(text)
            if said["say"] == "snapshot":
                seen[0] = said["is"]["number"]
                await socket.send(json.dumps({"say": "seen", "n": seen[0]}))

    async def drive(socket: Any, seen: list[int]) -> None:
        await asyncio.sleep(2.5)  # the machine ticks by then
        await socket.send(json.dumps({"say": "ask", "id": "1", "kind": "take"}))
        await asyncio.sleep(0.3)
        for n in range(1, MOST):
            levers = [n * STEP, 0, 0, 0, 0, 0]
            hands = {"say": "hands", "n": n, "seen": seen[0], "mode": "joint", "levers": levers, "enable": n > 5}
            sent.append((n, time.monotonic_ns()))
            await socket.send(json.dumps(hands))
            await asyncio.sleep(1 / 30)

    async def all_of_them() -> None:
        await asyncio.gather(*(one(k) for k in range(count)))

    with contextlib.suppress(OSError):
        asyncio.run(all_of_them())


def quantiles(values: list[float]) -> dict[str, float]:
    """Return median and 99th percentile."""
    ordered = sorted(values)
    return {"median": statistics.median(ordered), "p99": ordered[int(0.99 * (len(ordered) - 1))]}


def measured(count: int, seconds: float, turns: int) -> dict[str, Any]:
    """Return what pages cost."""
    prefer()
    loaded = load_scenario("pole-approach").choosing(guard="barrier")
    station = Station(loaded, DeskSettings())
    session = station.session
    access = Access("127.0.0.1", free_port(), None)
    plan = Plan.of(loaded, DeskSettings(), access, session.machine_id)
    mail = ZenohMail(**plan.bus("machine"))
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    server = context.Process(target=page_process, args=(plan, ready), daemon=True)
    server.start()
    ready.wait(60)
    time.sleep(2.0)
    ticks: dict[str, list[float]] = {"alone": [], "pages": []}
    late: dict[str, int] = {"alone": 0, "pages": 0}
    used: dict[int, int] = {}

    def observe(inputs: Any, _frame: bytes, _trace: Any) -> None:
        if inputs.intent is not None:
            used.setdefault(round(inputs.intent.levers.left_x / STEP), time.monotonic_ns())

    session.observe(observe)
    latencies: list[float] = []
    with context.Manager() as manager:
        for turn in range(2 * turns):
            name = "pages" if turn % 2 else "alone"
            sent = manager.list()
            clients = None
            used.clear()
            station.desk.seat("", time.monotonic_ns())
            if name == "pages":
                clients = context.Process(target=pages, args=(access.port, count, seconds + 1.2, sent), daemon=True)
                clients.start()
                time.sleep(1.5)
            pace, until = Pace(session.tick_s), time.monotonic() + seconds
            step = session.step

            def timed(*given: Any, step: Any = step, name: str = name) -> Any:
                done = step(*given)
                ticks[name].append(done.tick_ms)
                return done

            session.step = timed  # type: ignore[method-assign]
            run_station(station, mail, pace, lambda until=until: time.monotonic() < until)  # type: ignore[misc]
            session.step = step  # type: ignore[method-assign]
            late[name] += pace.late
            if clients is not None:
                clients.join(seconds + 5.0)
                latencies += [(used[n] - at) * 1e-6 for n, at in list(sent) if n in used]
    server.terminate()
    mail.close()
    return {
        "pages": count,
        "seconds": seconds * turns,
        "tick_ms": {name: quantiles(values) for name, values in ticks.items()},
        "late_ticks": late,
        "tick_ratio_median": statistics.median(ticks["pages"]) / statistics.median(ticks["alone"]),
        "key_to_command_ms": quantiles(latencies) if latencies else None,
        "hands": len(latencies),
        "tick_period_ms": session.tick_s * 1e3,
        "refused": {k: getattr(station.desk.heard, k) for k in station.desk.heard.__slots__},
    }


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--pages", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    threading.current_thread().name = "machine"
    found = measured(given.pages, given.seconds, given.turns)
    print(json.dumps(found, indent=None if given.json else 2))


if __name__ == "__main__":
    main()
