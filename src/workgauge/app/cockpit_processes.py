"""The cockpit's processes: machine, page, view, preview; each of them on its own, none needed by the machine."""

import contextlib
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from workgauge.app.event_log import EventLog
from workgauge.cockpit.access import Access
from workgauge.rehearse.scenario_file import LoadedScenario
from workgauge.rehearse.station.desk import DeskSettings
from workgauge.values.errors import WorkgaugeError

#: Looking after the processes [s]; between two beginnings of one that dies at once [s].
LOOK_S, AGAIN_S = 0.25, 2.0
#: Lower priority of everything but the machine, and higher of that.
NICE = 10
#: Of the tick among what must be done in time: the least, above everything else.
TICK_PRIORITY = 1


#: The order they begin in; each connects to those before it.
_ORDER = ("machine", "page", "view", "preview")


def _address(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


@dataclass(frozen=True, slots=True)
class Plan:
    """What all processes are told.

    Attributes:
        loaded: the scenario. desk: of the driver's link. access: to the page. machine_id: whose.
        log: a file events are added to, None for none.
        ports: process to the port it listens on for the others; `scene` is the view's own. All on loopback.
    """

    loaded: LoadedScenario
    desk: DeskSettings
    access: Access
    ports: Mapping[str, int]
    machine_id: str
    log: Path | None = None

    @classmethod
    def of(
        cls, loaded: LoadedScenario, desk: DeskSettings, access: Access, machine_id: str, log: Path | None = None
    ) -> "Plan":
        """Return a plan on ports that are free now."""
        return cls(loaded, desk, access, {name: free_port() for name in (*_ORDER, "scene")}, machine_id, log)

    def bus(self, name: str) -> dict[str, Any]:
        """Return where a process listens, and whom it connects to: those before it in the order they begin."""
        before = _ORDER[: _ORDER.index(name)]
        return {"listen": _address(self.ports[name]), "connect": [_address(self.ports[one]) for one in before]}


def free_port() -> int:
    """Return a port of this computer that is free now."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def port_taken(host: str, port: int) -> bool:
    """Return whether something listens there already."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((host, port))
        except OSError:
            return True
    return False


def prefer() -> None:
    """Ask the system to run this process before others, where it lets us."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -NICE)


def prefer_tick() -> None:
    """Ask the system to let nothing come between a tick's beginning and its end, where it lets us.

    This thread alone, and only while it has something to do: the bus's threads and all other programs run meanwhile.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(TICK_PRIORITY))


def machine_process(plan: Plan, ready: Any) -> None:
    """Run the machine."""
    from workgauge.bus.pace import Pace
    from workgauge.bus.zenoh_mail import ZenohMail
    from workgauge.rehearse.station.running import run_station
    from workgauge.rehearse.station.station import Station

    prefer()
    with _until_told() as going, contextlib.ExitStack() as files:
        file = [] if plan.log is None else [files.enter_context(plan.log.open("a", encoding="utf-8"))]
        log = EventLog([sys.stderr, *file])
        station = Station(plan.loaded, plan.desk, log)
        mail = ZenohMail(**plan.bus("machine"))
        ready.set()
        prefer_tick()
        run_station(station, mail, Pace(station.session.tick_s), going)
        mail.close()
        log.close()


def page_process(plan: Plan, ready: Any) -> None:
    """Serve the page."""
    import uvicorn

    from workgauge.bus.zenoh_mail import ZenohMail
    from workgauge.cockpit.hub import Hub
    from workgauge.cockpit.server import Cockpit
    from workgauge.cockpit.speech import LONGEST

    os.nice(NICE // 2)
    mail = ZenohMail(**plan.bus("page"))
    cockpit = Cockpit(Hub(mail, plan.machine_id), plan.access, f"ws://127.0.0.1:{plan.ports['scene']}")
    config = uvicorn.Config(
        cockpit.app(),
        host=plan.access.host,
        port=plan.access.port,
        log_level="warning",
        ws_max_size=max(4 * LONGEST, 1 << 20),
        ws_per_message_deflate=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    parent = _beginner()

    def orphaned() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_S)
        server.should_exit = True

    threading.Thread(target=orphaned, daemon=True).start()
    ready.set()
    server.run()
    mail.close()


def view_process(plan: Plan, ready: Any) -> None:
    """Show the scene."""
    from workgauge.bus.zenoh_mail import ZenohMail
    from workgauge.cockpit.view import View
    from workgauge.rehearse.run import open_session

    os.nice(NICE)
    with _until_told() as going:
        mail = ZenohMail(**plan.bus("view"))
        view = View(open_session(plan.loaded), mail, plan.ports["scene"])
        ready.set()
        view.run(going)
        mail.close()


def preview_process(plan: Plan, ready: Any) -> None:
    """Look at goals ahead of time."""
    from workgauge.bus.zenoh_mail import ZenohMail
    from workgauge.rehearse.station.previewing import Previewer
    from workgauge.rehearse.station.running import run_previews

    os.nice(NICE)
    with _until_told() as going:
        mail = ZenohMail(**plan.bus("preview"))
        previewer = Previewer(plan.loaded)
        ready.set()
        run_previews(previewer, mail, lambda: time.sleep(0.02), going)
        mail.close()


#: Beside the machine: begun again when they die.
HELPERS: dict[str, Callable[[Plan, Any], None]] = {
    "page": page_process,
    "view": view_process,
    "preview": preview_process,
}


def _beginner() -> int:
    """Return the id of the process that began this one, even if that is gone already."""
    parent = multiprocessing.parent_process()
    return os.getppid() if parent is None or parent.pid is None else parent.pid


@contextlib.contextmanager
def _until_told() -> Iterator[Callable[[], bool]]:
    """Yield whether to go on: until asked to stop, or until whoever began this process is gone."""
    parent, going = _beginner(), [True]

    def stop(*_: object) -> None:
        going[0] = False

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield lambda: going[0] and os.getppid() == parent


class Minder:
    """Begins the processes and looks after them: the machine's end is the end of all, any other's is not.

    Args:
        plan: see `Plan`. say: is told what happens.
    """

    def __init__(self, plan: Plan, say: Callable[[str], None]) -> None:
        self._plan, self._say = plan, say
        self._context = multiprocessing.get_context("spawn")
        self.running: dict[str, BaseProcess] = {}
        self._begun_s: dict[str, float] = {}
        self._ready: dict[str, Any] = {}  # kept: a process that begins takes its own up later

    def start(self, patience_s: float = 180.0) -> None:
        """Begin all, the machine first; return when the page can be opened.

        Raises:
            WorkgaugeError: if the machine does not begin.
        """
        if not self._begin("machine", machine_process).wait_for(patience_s):
            raise WorkgaugeError("the machine's process did not begin")
        waits = [self._begin(name, run) for name, run in HELPERS.items()]
        for one in waits:
            one.wait_for(patience_s)

    def mind(self) -> bool:
        """Begin again what died; return whether the machine still runs."""
        for name, run in HELPERS.items():
            process = self.running[name]
            if not process.is_alive() and time.monotonic() - self._begun_s[name] > AGAIN_S:
                self._say(f"the {name} process has ended ({process.exitcode}): begun again, the machine went on")
                self._begin(name, run)
        return self.running["machine"].is_alive()

    def stop(self) -> None:
        """End all, the machine last."""
        for name in (*HELPERS, "machine"):
            process = self.running.get(name)
            if process is not None:
                process.terminate()
        for process in self.running.values():
            process.join(5.0)
            if process.is_alive():
                process.kill()

    def _begin(self, name: str, run: Callable[[Plan, Any], None]) -> "_Wait":
        ready = self._ready[name] = self._context.Event()
        process = self._context.Process(target=run, args=(self._plan, ready), name=f"workgauge {name}", daemon=True)
        process.start()
        self.running[name], self._begun_s[name] = process, time.monotonic()
        return _Wait(process, ready)


@dataclass(frozen=True, slots=True)
class _Wait:
    process: BaseProcess
    ready: Any

    def wait_for(self, patience_s: float) -> bool:
        """Return whether it is ready in time; False as soon as it has ended."""
        until = time.monotonic() + patience_s
        while time.monotonic() < until and self.process.is_alive():
            if self.ready.wait(0.1):
                return True
        return bool(self.ready.is_set())
