"""Runs on receivers from outside: the undercarriage stands where a log or a serial port says."""

import json
import math
import os
import threading
import time
import tty
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from workgauge.app.cli import app
from workgauge.app.gnss_run import OwnSite, gnss_run
from workgauge.gauge.rulebook import load_rule_book
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.load import load_machine
from workgauge.positioning.track import RailTrack
from workgauge.rehearse.gnss_session import GnssSession
from workgauge.rehearse.log_file import log_files
from workgauge.rehearse.receivers import LogReceivers, PortReceivers, open_receivers
from workgauge.rehearse.run import run_session
from workgauge.rehearse.scenario import Hold
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.rehearse.standing import receiver_ports
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import FixNoise, LinkSettings, ReceiverSettings, SensorSettings
from workgauge.site.read import read_site
from workgauge.values.errors import InputError
from workgauge.values.health import HealthState
from workgauge.values.measurements import Levers

#: Where on Track 1 the log begins, how fast the machine goes, and for how long.
START_M, SPEED_M_S, SECONDS = 540.0, 1.0, 4.5


@pytest.fixture(scope="module")
def machine():
    return load_machine("rre20")


@pytest.fixture(scope="module")
def site():
    return read_site(shipped_site_files("double_track"))


@pytest.fixture(scope="module")
def rails(site, machine):
    track = next(one for one in site.alignments if "1" in one.name)
    return RailTrack.of(site, load_rule_book("finland"), track, machine.undercarriage.height_m)


@pytest.fixture(scope="module")
def sent(site, machine, rails):
    """What the receivers send of a drive along Track 1, free of noise: (time [s], port, bytes)."""
    frame = site.frame()
    exact = ReceiverSettings(rate_hz=10, noise=FixNoise(scale=0.0, velocity_m_s=0.0))
    settings = SensorSettings(receivers=exact, links=LinkSettings(scale=0.0, gyros=False))
    kit = SensorKit(machine, site.crs, frame, settings, machine_id="rre20")
    ports = receiver_ports(machine.positioning)
    out = []
    for i in range(round(SECONDS * 50)):
        kit.advance(i * 20_000_000, machine.home, pose(rails, frame, i * 0.02))
        out += [(i * 0.02, c.port, c.data) for c in kit.read(i * 20_000_000) if c.port in ports]
    return out


def pose(rails, frame: SiteFrame, t_s: float) -> np.ndarray:
    T = rails.poses(np.array([START_M + SPEED_M_S * t_s]))[0][0].copy()
    T[:3, 3] = frame.to_local(T[:3, 3])
    return T


@pytest.fixture
def logs(sent, machine, tmp_path):
    paths = []
    for port in receiver_ports(machine.positioning):
        paths.append(tmp_path / f"{port}.nmea")
        paths[-1].write_bytes(b"".join(data for _, one, data in sent if one == port))
    return [str(path) for path in paths]


def test_the_undercarriage_goes_where_the_log_goes(logs, site, machine, rails):
    session = GnssSession(open_receivers(logs, machine), site, machine, rules="finland")
    begin = session.stand.T_absolute_machine[:3, 3]
    assert np.linalg.norm(begin[:2] - rails.poses(np.array([START_M + 1.0]))[0][0][:2, 3]) < 1.0
    places, states = [], []
    while not session.finished:
        done = session.step(session.intent())
        places.append(session.frame.to_absolute(session.true_state[1][:3, 3]))
        states.append(done.known.health.state)
    assert states[0] is HealthState.STOP and states[-1] is HealthState.FIXED
    end = rails.poses(np.array([START_M + SPEED_M_S * SECONDS]))[0][0][:3, 3]
    assert np.linalg.norm(places[-1] - end) < 0.25  # a log's last epoch and latency before its end
    way = np.linalg.norm(np.diff(np.array(places)[np.array(states) == HealthState.FIXED], axis=0), axis=1).sum()
    assert way > 0.7 * SPEED_M_S * SECONDS - 1.5
    on_rails = [abs(float(rails.alignment.project([place[:2]])[1][0])) for place in places[200:]]
    assert max(on_rails) < 0.15  # cant shifts the middle, no more
    T = session.true_state[1]
    yaw = math.atan2(T[1, 0], T[0, 0])
    assert abs(math.remainder(yaw - rails.yaw(START_M + SPEED_M_S * SECONDS), 2 * math.pi)) < math.radians(0.2)


def test_simulated_joints_do_not_move_the_antennas(logs, site, machine):
    """The cab swings under antennas that stay where they were: the position must not notice."""
    session = GnssSession(open_receivers(logs, machine), site, machine, rules="finland")
    while not session.ready and not session.finished:
        session.step(session.intent(enable=False))
    session.step(session.intent())
    swung = machine.joint_names.index("swing")
    before = session.true_state[0][swung]
    states = set()
    while not session.finished:
        done = session.step(session.intent(levers=Levers(left_x=-0.6)))
        states.add(done.known.health.state)
        assert done.known.posture.q[swung] == done.trace.q[swung]
    assert abs(session.true_state[0][swung] - before) > 0.2
    assert states == {HealthState.FIXED}


def test_an_unplugged_receiver_is_a_warning_and_a_stop(logs, site, machine):
    class Unplugged(LogReceivers):
        """Half way, the cable is pulled."""

        @property
        def faults(self) -> tuple[str, ...]:
            return ("/dev/ttyX: gone",) if self.pulled else ()

        pulled = False

        def read(self, now_ns: int) -> list:
            self.pulled = now_ns > 2.5e9
            return [] if self.pulled else super().read(now_ns)

    receivers = Unplugged(log_files(logs, receiver_ports(machine.positioning)), machine)
    session = GnssSession(receivers, site, machine, rules="finland")
    states = []
    while session.t_s < 4.6:
        states.append(session.step(session.intent()).known.health.state)
    assert [text for text in session.stand.warnings if "ttyX" in text] == ["at 2.5 s: /dev/ttyX: gone"]
    assert HealthState.FIXED in states and HealthState.DEAD_RECKONING in states
    assert states[-1] is not HealthState.FIXED


def test_the_run_says_what_it_stands_on(logs, machine):
    own = OwnSite(shipped_site_files("double_track"), "rre20", "finland", "linear", None)
    with gnss_run(logs, own) as (session, steps, words, said, states):
        assert isinstance(steps[-1], Hold)
        result = run_session(session, steps, *words, said, states=states)
    assert result.simulated_s == pytest.approx(SECONDS, abs=0.2)
    assert any("no other truth" in text for text in result.assumptions)
    assert any("gnss-left.nmea" in text for text in result.assumptions)
    assert result.min_clearance_m is not None and result.min_clearance_m > 0
    assert session.tallies["gnss-left"].good > 100 and session.tallies["gnss-left"].bad == 0


def command(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["run", *map(str, arguments)], catch_exceptions=False)
    return done.exit_code, done.stdout, done.stderr


def test_the_command_runs_on_logs(logs, tmp_path):
    files = shipped_site_files("double_track")
    code, out, err = command(
        "--site", *files, "--rules", "finland", "--gnss", logs[0], "--gnss", f"gnss-right={logs[1]}", "--json",
        "--report", tmp_path / "report",
    )  # fmt: skip
    assert code == 0, err
    told = json.loads(out)
    assert told["simulated_s"] == pytest.approx(SECONDS, abs=0.2)
    assert (tmp_path / "report" / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--gnss", "missing.nmea"), "missing.nmea"),
        (("--gnss", "."), "directory"),
        (("--gnss", "LOG", "--machine", "sun-a"), "positioning"),
        (("--gnss", "LOG", "--at", "1,2,3"), "--at"),
        (("--gnss", "LOG", "--scenario", "travel"), "travel"),
        (("--gnss", "LOG"), "no position"),
    ],
)
def test_the_command_refuses(logs, tmp_path, arguments, word):
    given = [logs[0] if one == "LOG" else one for one in arguments]
    code, out, err = command(*given, "--report", tmp_path / "report", "--json")
    assert (code, out) == (2, "")
    assert word in err and "Traceback" not in err
    assert not (tmp_path / "report").exists()


def test_one_antenna_of_two_is_refused_with_the_reason(logs, site, machine):
    with pytest.raises(InputError, match="no position the machine could start from") as caught:
        GnssSession(open_receivers(logs[:1], machine), site, machine, rules="finland")
    assert "gnss-left.nmea" in str(caught.value)


def test_a_log_far_from_the_site_is_refused(logs, site, machine, tmp_path):
    text = [Path(log).read_bytes() for log in logs]
    moved = []
    for i, one in enumerate(text):
        path = tmp_path / f"moved{i}.nmea"
        path.write_bytes(b"\r\n".join(_moved(line) for line in one.split(b"\r\n")))
        moved.append(str(path))
    with pytest.raises(InputError, match=r"receivers put the machine|no position"):
        GnssSession(open_receivers(moved, machine), site, machine, rules="finland")


def _moved(line: bytes) -> bytes:
    """Put a GGA or RMC two degrees to the north."""
    if not line.startswith((b"$GNGGA", b"$GNRMC")):
        return line
    parts = line[1:].split(b"*")[0].split(b",")
    k = 2 if parts[0].endswith(b"GGA") else 3
    parts[k] = b"62" + parts[k][2:]
    body = b",".join(parts)
    check = 0
    for byte in body:
        check ^= byte
    return b"$" + body + b"*%02X" % check


def test_what_is_neither_log_nor_device(machine, tmp_path, logs):
    with pytest.raises(InputError, match="no such file"):
        open_receivers(["/dev/ttyMISSING0", logs[0]], machine)
    with pytest.raises(InputError, match="together"):
        open_receivers(["/dev/null", logs[0]], machine)
    with pytest.raises(InputError, match="opened"):
        open_receivers(["/dev/null"], machine)
    with pytest.raises(InputError, match="no such receivers"):
        open_receivers(["middle=/dev/null"], machine)
    with pytest.raises(InputError, match="positioning"):
        open_receivers(logs[:1], load_machine("sun-a"))


def test_a_replayed_log_never_goes_back(logs, machine):
    receivers = LogReceivers(log_files(logs, receiver_ports(machine.positioning)), machine)
    receivers.begin()
    arrived = [chunk.received_ns for now in range(0, 7 * 10**9, 10**7) for chunk in receivers.read(now)]
    assert len(arrived) > 80 and all(a <= b for a, b in pairwise(arrived))
    assert receivers.finished(0)


class _Ends:
    """Two pseudo-terminals that a thread feeds with what the receivers sent, in real time and over again."""

    def __init__(self, sent, ports: tuple[str, ...]) -> None:
        self.pairs = {port: os.openpty() for port in ports}
        for far, near in self.pairs.values():
            tty.setraw(near)
            tty.setraw(far)
        self.names = {port: os.ttyname(near) for port, (_, near) in self.pairs.items()}
        self._sent, self._stop = sent, threading.Event()
        self._thread = threading.Thread(target=self._feed, daemon=True)

    def __enter__(self) -> "_Ends":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=5)
        for far, near in self.pairs.values():
            os.close(far)
            os.close(near)

    def _feed(self) -> None:
        began = time.monotonic()
        for t_s, port, data in self._sent:
            if self._stop.wait(max(0.0, began + t_s - time.monotonic())):
                return
            os.write(self.pairs[port][0], data)


def test_serial_ports_in_real_time(pseudo_terminals, sent, site, machine):
    ports = receiver_ports(machine.positioning)
    with _Ends(sent, ports) as ends:
        receivers = PortReceivers([(ends.names[port], 115_200, port) for port in ports], patience_s=5.0)
        try:
            frame = site.frame()
            T = receivers.first_pose(machine, site.crs, frame)
            begin = pose_along(site, T, frame)
            assert START_M - 1 < begin < START_M + SPEED_M_S * SECONDS + 1
            receivers.begin()
            before = time.monotonic()
            receivers.wait_until(300_000_000)
            assert time.monotonic() - before >= 0.25
            chunks = receivers.read(300_000_000)
            assert {chunk.port for chunk in chunks} <= set(ports) and chunks
            assert all(0 <= chunk.received_ns <= 300_000_000 for chunk in chunks)
            assert receivers.faults == ()
        finally:
            receivers.close()


def pose_along(site, T, frame) -> float:
    track = next(one for one in site.alignments if "1" in one.name)
    return float(track.project([frame.to_absolute(T[:3, 3])[:2]])[0][0])


def test_a_silent_port_is_refused_after_patience(pseudo_terminals, site, machine):
    ports = receiver_ports(machine.positioning)
    with _Ends([], ports) as ends:
        receivers = PortReceivers([(ends.names[port], 115_200, port) for port in ports], patience_s=0.3)
        try:
            with pytest.raises(InputError, match="no position"):
                receivers.first_pose(machine, site.crs, site.frame())
        finally:
            receivers.close()
