"""Logs through a machine's own positioning: heading and pose of a machine whose truth is known."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from workgauge.app.cli import app
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.load import load_machine
from workgauge.rehearse.located_log import STANDING, locate, machine_rows, positioning_of, replayed
from workgauge.rehearse.log_file import log_files
from workgauge.rehearse.replay import timeline
from workgauge.rehearse.standing import StandingSensors, receiver_ports
from workgauge.rehearse.track_log import read_track
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import FixNoise, LinkSettings, ReceiverSettings, SensorSettings
from workgauge.values.errors import MachineError
from workgauge.values.health import HealthState
from workgauge.values.navigation import Inclination
from workgauge.wire.stream import StreamDecoder

CRS = ProjectedCrs.from_epsg(3879)
ORIGIN = np.array([25_487_300.0, 6_714_600.0, 0.0])
SECONDS, RATE_HZ = 4.0, 10


def truth(t_s: float) -> np.ndarray:
    """A machine that drives an arc, level."""
    yaw = math.radians(48.0 - 2.0 * t_s)
    T = np.eye(4)
    T[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    T[:3, 3] = -12.0 + 0.3 * t_s, -4.5 + 0.2 * t_s, 20.0
    return T


@pytest.fixture(scope="module")
def machine():
    return load_machine("rre20")


@pytest.fixture(scope="module")
def logs(machine, tmp_path_factory):
    """The two receivers' logs, free of noise."""
    exact = ReceiverSettings(rate_hz=RATE_HZ, noise=FixNoise(scale=0.0, velocity_m_s=0.0))
    settings = SensorSettings(receivers=exact, links=LinkSettings(scale=0.0, gyros=False))
    kit = SensorKit(machine, CRS, SiteFrame(CRS, ORIGIN), settings, machine_id="rre20")
    bytes_of: dict[str, bytearray] = {port: bytearray() for port in receiver_ports(machine.positioning)}
    for i in range(round(SECONDS * 100)):
        kit.advance(i * 10_000_000, machine.home, truth(i * 0.01))
        for chunk in kit.read(i * 10_000_000):
            if chunk.port in bytes_of:
                bytes_of[chunk.port] += chunk.data
    folder = tmp_path_factory.mktemp("logs")
    paths = []
    for port, data in bytes_of.items():
        paths.append(folder / f"{port}.nmea")
        paths[-1].write_bytes(data)
    return log_files([str(path) for path in paths], receiver_ports(machine.positioning))


@pytest.fixture(scope="module")
def found(machine, logs):
    track = read_track(logs, CRS, HeightModel.from_sentence())
    located = locate(logs, machine, CRS, HeightModel.from_sentence(), track.somewhere)
    return located, track, *machine_rows(track, located)


def test_two_antennas_give_the_heading_at_every_epoch(found):
    _, before, track, _, _ = found
    assert np.isnan(before.heading).all()
    t_s = track.t_s - track.t_s.min()
    expected = np.radians(90.0 - (48.0 - 2.0 * t_s))
    off = np.mod(track.heading - expected + np.pi, 2 * np.pi) - np.pi
    assert np.abs(np.degrees(off)).max() < 0.01  # NMEA's last digits


def test_the_undercarriage_is_where_it_was(found):
    _, _, track, states, rows = found
    placed = 0
    for t_s, state, row in zip(track.t_s - track.t_s.min(), states, rows, strict=True):
        assert row is not None and state in ("stop", "fixed")
        if state == "fixed":
            T = truth(float(t_s))
            place = np.array([row["e"], row["n"], row["z"]]) - ORIGIN
            assert np.linalg.norm(place - T[:3, 3]) < 0.01
            assert row["heading_deg"] == pytest.approx(42.0 + 2.0 * t_s, abs=0.05)
            assert abs(row["pitch_deg"]) < 0.05 and abs(row["roll_deg"]) < 0.05
            assert min(row["sigma_m"]) > 0.0 and row["sigma_heading_deg"] > 0.0
            placed += 1
        else:
            assert row["reasons"]
    assert placed > len(track) / 2


def test_what_is_assumed_is_said(found):
    located, _, track, _, _ = found
    assert STANDING in located.warnings and STANDING in track.warnings


def test_one_receiver_of_two_gives_no_heading_and_says_stop(machine, logs):
    track = read_track(logs[:1], CRS, HeightModel.from_sentence())
    located = locate(logs[:1], machine, CRS, HeightModel.from_sentence(), track.somewhere)
    track, states, rows = machine_rows(track, located)
    assert set(states) == {"stop"}
    assert np.isnan(track.heading).all()
    assert all("e" not in row and row["reasons"] for row in rows)


def test_the_command_says_it_all(logs, tmp_path):
    paths = [str(log.path) for log in logs]
    asked = ["pose", *paths, "--epsg", "3879", "--machine", "rre20", "--report", str(tmp_path / "report"), "--json"]
    done = CliRunner().invoke(app, asked, catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    last = told["epochs"][-1]
    assert last["health"] == "fixed" and last["machine"]["reasons"] == []
    assert last["heading_deg"] == pytest.approx(last["machine"]["heading_deg"], abs=0.01)
    assert STANDING in told["warnings"] and "road-rail" in told["health"]
    assert "grid heading" in (tmp_path / "report" / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("ports", "machine_name", "word"),
    [(("", ""), "sun-a", "positioning"), (("middle=", ""), "rre20", "port"), (("", ""), "none.yaml", "none.yaml")],
)
def test_the_command_refuses(logs, ports, machine_name, word):
    paths = [f"{port}{log.path}" for port, log in zip(ports, logs, strict=True)]
    done = CliRunner().invoke(app, ["pose", *paths, "--epsg", "3879", "--machine", machine_name, "--json"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert word in done.stderr and len(done.stderr.splitlines()) == 1


def test_a_machine_without_positioning_is_refused(machine):
    with pytest.raises(MachineError, match="sun-a"):
        positioning_of(load_machine("sun-a"))


def test_standing_sensors_read_level_and_home(machine):
    standing = StandingSensors(machine, "rre20", CRS, SiteFrame(CRS, ORIGIN))
    decoder = StreamDecoder("links", "rre20")
    values = [one for chunk in standing.read(7_000) for one in decoder.feed(chunk)]
    assert {one.stamp.monotonic_ns for one in values} == {7_000}
    tilt = next(one for one in values if one.stamp.source == machine.positioning.tilt.sensor)
    assert isinstance(tilt, Inclination) and abs(tilt.roll) < 1e-12 and abs(tilt.pitch) < 1e-12
    named = {joint.sensor for joint in machine.positioning.joints}
    assert named <= {one.stamp.source for one in values}


def test_health_sees_time_pass_in_a_gap(machine, logs, tmp_path):
    """Nearly two seconds cut out of both logs: carried on meanwhile, not judged only when the next fix comes."""
    cut = []
    for log in logs:
        text = log.path.read_bytes().splitlines(keepends=True)
        path = tmp_path / log.path.name
        path.write_bytes(b"".join((*text[: len(text) // 2], *text[len(text) * 19 // 20 :])))
        cut.append(replace(log, path=path))
    moments = list(replayed(timeline(cut), machine, CRS, SiteFrame(CRS, ORIGIN), standing=True))
    silent = {moment.located.health.state for moment in moments if not moment.heard}
    assert HealthState.DEAD_RECKONING in silent
    assert HealthState.DEAD_RECKONING not in {moment.located.health.state for moment in moments if moment.heard}
