"""What the cockpit's processes ask of the system, and who hears whom."""

import os
import threading

import pytest

pytest.importorskip("starlette", reason="the cockpit's extra is not installed")

from workgauge.app.cockpit_processes import Plan, free_port, port_taken, prefer_tick
from workgauge.cockpit.access import Access
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.station.desk import DeskSettings


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no scheduling classes on this system")
def test_the_tick_alone_goes_first_where_the_system_lets_it() -> None:
    found: dict[str, int] = {}

    def note(name: str) -> None:
        found[name] = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK

    def tick() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            found["allowed"] = 1
        except OSError:
            found["allowed"] = 0
        prefer_tick()
        note("tick")
        other = threading.Thread(target=note, args=("begun by it",))
        other.start()
        other.join()

    one = threading.Thread(target=tick)
    one.start()
    one.join()
    note("main")
    assert found["tick"] == (os.SCHED_FIFO if found["allowed"] else os.SCHED_OTHER)
    assert found["begun by it"] == found["main"] == os.SCHED_OTHER


def test_every_process_hears_every_other_on_loopback_alone() -> None:
    loaded = load_scenario("pole-approach")
    plan = Plan.of(loaded, DeskSettings(), Access("127.0.0.1", 8600), "rre20")
    buses = {name: plan.bus(name) for name in ("machine", "page", "view", "preview")}
    assert len(set(plan.ports.values())) == 5
    for one, bus in buses.items():
        assert all(address.startswith("tcp/127.0.0.1:") for address in (bus["listen"], *bus["connect"]))
        for other, theirs in buses.items():
            if one != other:
                assert (theirs["listen"] in bus["connect"]) != (bus["listen"] in theirs["connect"])


def test_a_port_that_is_taken_is_told() -> None:
    import socket

    port = free_port()
    assert not port_taken("127.0.0.1", port)
    with socket.create_server(("127.0.0.1", port)):
        assert port_taken("127.0.0.1", port)
