"""Driving a drive: the product's own tick in front of simulated hydraulics, and the truth beside it."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from workgauge.guard.api import Guard
from workgauge.loop.config import TickConfig, search_radius_m, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import Trace, tick
from workgauge.motion.desired import MotionConfig
from workgauge.motion.joystick import LeverFeel
from workgauge.rehearse.drives.bus import IN_TIME, Bus, BusSettings
from workgauge.rehearse.drives.draw import Drive
from workgauge.rehearse.drives.dynamics import flying_s
from workgauge.rehearse.drives.watch import NEAR_M, Nearest, Watch
from workgauge.sim.joints import HydraulicJoints
from workgauge.values.arrays import Floats, frozen
from workgauge.values.measurements import Intent, Levers, MachinePose, Posture, Stamp

#: After the beginning and after whatever shut the gate: the tick with the enable switch let go, and the one with it
#: pressed again and the levers in the middle. From the next on they are worked.
_LET_GO, _PRESSED = 1, 2
#: A machine slower than this in all joints has come to rest [rad/s, m/s].
_RESTING = 1e-3
#: Nothing takes longer to come to rest [s].
_LONGEST_S = 30.0
_MACHINE_ID = "drive"


@dataclass(frozen=True, slots=True)
class DriveResult:
    """What one guard made of one drive.

    Attributes:
        seed, kind, place, guard: which drive, where and whose.
        entries: number of limits entered, own links among them. entered: their ids.
        worst_clearance_m: smallest true clearance; at most what was in sight.
        worst_less_stop_m: smallest true clearance less the stop distance that applies.
        nearest: the smallest of both per kind of limit and link, of what came within a metre or so.
        motion: way of all joints together [rad, and m of joints that slide].
        free_motion: the same for the same hands without any guard.
        near: whether it was ever within 1 m of a limit or of itself.
        ticks: in which levers were worked. shut: of these, with the gate shut.
        rest_s: time to come to rest at the end.
    """

    seed: int
    kind: str
    place: str
    guard: str
    entries: int
    entered: tuple[str, ...]
    worst_clearance_m: float
    worst_less_stop_m: float
    nearest: tuple[Nearest, ...]
    motion: float
    free_motion: float
    near: bool
    ticks: int
    shut: int
    rest_s: float

    def plain(self) -> dict[str, Any]:
        """Return it as dicts, lists, numbers and strings."""
        return asdict(self)

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> "DriveResult":
        """Return the result whose `plain` form this is, from JSON too."""
        nearest = tuple(Nearest(**one) for one in plain["nearest"])
        return cls(**{**plain, "entered": tuple(plain["entered"]), "nearest": nearest})


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One tick of a drive, for those who want to see it: its time, the true posture at its end, and its trace."""

    t_s: float
    q: Floats
    trace: Trace


def drive_config(drive: Drive, guard: Guard) -> TickConfig:
    """Return how the tick is set up for a drive: as in a session, with the attachment's place known exactly."""
    settings = drive.settings
    return tick_config(
        drive.machine,
        guard,
        machine_id=_MACHINE_ID,
        dt_s=settings.dt_s,
        radius_m=max(settings.radius_m, search_radius_m(guard, drive.place.scene.limits)),
        tool_sigma_m=0.0,
        motion=MotionConfig(feel=LeverFeel(), tool_speed_m_s=settings.tool_speed_m_s),
    )


def run_drive(drive: Drive, guard: Guard, bus: BusSettings = IN_TIME) -> DriveResult:
    """Drive it with a guard from a fresh memory, let every lever go, and wait until the machine rests.

    A drive, a guard and a bus give the same result bit for bit.
    """
    run = DriveRun(drive, guard, bus)
    for _ in run.steps():
        pass
    return run.result()


class DriveRun:
    """One guard on one drive.

    Args:
        drive: which one. guard: its own, memory afresh. bus: to the valves.
    """

    def __init__(self, drive: Drive, guard: Guard, bus: BusSettings = IN_TIME) -> None:
        self._drive, self._guard = drive, guard
        self._late = bus
        self._bus = Bus(bus, drive.seed, drive.settings.dt_s / drive.settings.substeps)
        self._config = drive_config(drive, guard)
        self._hands = _Hands(drive)
        self._real = HydraulicJoints(drive.machine, drive.hydraulics)
        self._free = HydraulicJoints(drive.machine, drive.hydraulics)
        self._q, self._q_free = np.array(drive.q), np.array(drive.q)
        settings = drive.settings
        place = drive.place
        self.watch = Watch(place.truth, place.T_site_machine, settings.stop_distance_m, drive.q, settings.near_m)
        self._motion = self._free_motion = self._rest_s = 0.0
        self._ticks = self._shut = 0

    def steps(self) -> Iterator[Step]:
        """Drive, tick by tick; to be gone through once and to the end."""
        settings, config = self._drive.settings, self._config
        memory = first_memory(config)
        free_valves = (0,) * config.machine.n
        for k in range(round(settings.seconds / settings.dt_s)):
            if self._bus.misses(self._hands.waits(k)):
                self._move(None, free_valves if memory.gate.open else (0,) * config.machine.n)
                continue
            inputs = self._hands.inputs(k, self._q)
            _, memory, trace = tick(inputs, memory, config)
            self._ticks += 1
            self._shut += not memory.gate.open
            free_valves = config.drive.valves(trace.desired.tolist(), self._q_free.tolist(), free_valves)
            self._move(memory.valves, free_valves if memory.gate.open else (0,) * config.machine.n)
            yield Step(k * settings.dt_s, self._q, trace)
        self._come_to_rest()
        self.watch.finish()

    def result(self) -> DriveResult:
        """Return what came of it."""
        drive, watch = self._drive, self.watch
        return DriveResult(
            seed=drive.seed,
            kind=drive.kind,
            place=drive.place.words,
            guard=self._guard.name,
            entries=len(watch.entered),
            entered=tuple(sorted(watch.entered)),
            worst_clearance_m=watch.worst_m,
            worst_less_stop_m=watch.worst_less_stop_m,
            nearest=watch.found(),
            motion=self._motion,
            free_motion=self._free_motion,
            near=watch.worst_m < NEAR_M,
            ticks=self._ticks,
            shut=self._shut,
            rest_s=self._rest_s,
        )

    def _move(self, valves: tuple[int, ...] | None, free_valves: tuple[int, ...]) -> None:
        """Let a tick's time pass for the real machine and for the one without a guard; None for nothing sent."""
        settings = self._drive.settings
        dt = settings.dt_s / settings.substeps
        if valves is not None:
            self._bus.send(valves)
        path = []
        for _ in range(settings.substeps):
            arrived = self._bus.arrived()
            if arrived is not None:
                self._real.set_valves(arrived)
            before, self._q = self._q, self._real.advance(dt, self._q)
            self._motion += float(np.abs(self._q - before).sum())
            path.append(self._q)
        self._free.set_valves(free_valves)
        before, self._q_free = self._q_free, self._free.advance(settings.dt_s, self._q_free)
        self._free_motion += float(np.abs(self._q_free - before).sum())
        self.watch.moved(path)

    def _come_to_rest(self) -> None:
        """Close every valve and wait for what flies."""
        still = (0,) * self._drive.machine.n
        flying_s = self._flying_s()
        while self._rest_s < _LONGEST_S:
            self._move(still, still)
            self._rest_s += self._drive.settings.dt_s
            speeds = np.maximum(np.abs(self._real.velocity), np.abs(self._free.velocity))
            if self._rest_s > flying_s and float(speeds.max(initial=0.0)) < _RESTING:
                return

    def _flying_s(self) -> float:
        dt_s = self._drive.settings.dt_s
        return flying_s(self._drive.hydraulics) + self._late.longest_s(dt_s) + dt_s


class _Hands:
    """Makes the inputs of every tick: programme, believed posture and pose."""

    def __init__(self, drive: Drive) -> None:
        settings = drive.settings
        self._drive = drive
        self._dt_ns = round(settings.dt_s * 1e9)
        T = np.array(drive.place.T_site_machine)
        T[:3, :3] = drive.T_error[:3, :3] @ T[:3, :3]
        T[:3, 3] += drive.T_error[:3, 3]
        self._T = frozen(T)
        doubt = settings.doubt
        self._covariance = frozen(np.diag([doubt.position_m**2] * 3 + [doubt.angle_rad**2] * 3))
        self._sigma = frozen(np.full(drive.machine.n, doubt.joint))
        self._last_lost = -1

    def waits(self, k: int) -> bool:
        """Return whether at tick k the gate is shut, or the enable switch is let go and pressed anew."""
        lost = self._drive.programme.lost_at(k * self._drive.settings.dt_s)
        return lost is not None or k - self._last_lost <= _PRESSED

    def inputs(self, k: int, q: Floats) -> TickInputs:
        """Return the inputs of tick k at the true posture q (n,)."""
        drive = self._drive
        now, t_s = k * self._dt_ns, k * drive.settings.dt_s
        stamp = Stamp(_MACHINE_ID, now, "drive", now)
        lost = drive.programme.lost_at(t_s)
        if lost is not None:
            self._last_lost = k
        since = k - self._last_lost
        held = drive.programme.held_at(t_s)
        enable = lost != "enable" and since != _LET_GO
        levers = held.levers if lost is not None or since > _PRESSED else Levers()
        intent = Intent(stamp, held.mode, levers, enable, held.line)
        return TickInputs(
            now,
            None if lost == "posture" else Posture(stamp, frozen(q + drive.q_error), self._sigma),
            None if lost == "pose" else MachinePose(stamp, self._T, self._covariance),
            None if lost == "intent" else intent,
            drive.place.scene,
        )
