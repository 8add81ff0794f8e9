"""A machine on a site, advanced one tick at a time: what the command line itself uses."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.gauge.build import LimitSet, build_limits
from workgauge.gauge.own_track import without_own_track
from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.rules import RuleBook
from workgauge.guard.api import Guard
from workgauge.guard.registry import guard_named
from workgauge.loop.config import search_radius_m, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import Trace, tick
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.rehearse.posture import start_posture
from workgauge.rehearse.result import Snapshot
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.shipped import shipped_names, shipped_site_files
from workgauge.rehearse.start import stand
from workgauge.rehearse.targets import nearest_point
from workgauge.rehearse.truth import GeometricTruth, Reading, snapshot
from workgauge.sim.kinematic import KinematicPlant
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import ScenarioError
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp, ToolLine
from workgauge.wire.messages import NAME_BYTES, decode

#: The shipped site, and the rule book it is built to.
SHIPPED_SITE, SHIPPED_SITE_RULES = "double_track", "finland"

#: Truth checks per tick.
SUBSTEPS = 2

#: How far truth looks round the machine [m]; the guard looks as far as the tick's own radius.
TRUTH_RADIUS_M = 10.0

#: A start posture takes the nearest pole into account up to this far away [m].
POLE_WITHIN_M = 15.0

#: Coordinates beyond this are on no map [m].
FARTHEST_M = 1e8

#: How far the tick looks: more than a full-speed stop of a 20 t machine (6.7 m).
TICK_RADIUS_M = 7.0


@dataclass(frozen=True, slots=True, eq=False)
class StepResult:
    """What one step did.

    Attributes:
        t_s: start of the tick [s].
        trace: what the tick saw, wanted and allowed, with its reasons.
        frame: the valve command bytes that left the tick.
        truth: the nearest true clearance within the step. tick_ms: wall-clock time of the tick alone [ms].
    """

    t_s: float
    trace: Trace
    frame: bytes
    truth: Reading
    tick_ms: float


class Session:
    """A site, a machine, a rule book and a guard, with a simulated machine behind the plant interface.

    Args:
        site: a read site, one or several site files, or the name of a shipped site.
        machine: a machine model, a description file, or the name of a shipped machine.
        rules: a rule book, a file, or the name of a shipped one; left out, `finland` for the shipped site, which is
            built to it, and `generic` for any other.
        guard: a guard, or the name of one; `guard_parameters` are its keywords then.
        at: (east [m], north [m], heading [°] clockwise from grid north), or `OnTrack`, or `OnGround`; left out, the
            middle of the first alignment.
        posture: joint name to position [rad, m]; joints not named keep the machine's home. None for home, or, if the
            arm would be in the way there, for a posture like it that is clear of the nearest pole.
        attachment: the attachment to mount, if the machine is loaded here.
        tick_s: tick period [s]. epsg: coordinate system, where the site files name none or a wrong one.

    Raises:
        InputError: for anything handed in that cannot be used; `ScenarioError` if the machine would start inside a
            limit or itself.
    """

    def __init__(
        self,
        site: SiteModel | str | Path | Sequence[str | Path] = SHIPPED_SITE,
        machine: MachineModel | str | Path = "rre20",
        rules: RuleBook | str | Path | None = None,
        guard: Guard | str = "linear",
        at: tuple[float, float, float] | OnTrack | OnGround | None = None,
        *,
        posture: Mapping[str, float] | None = None,
        attachment: str | None = None,
        guard_parameters: Mapping[str, float] | None = None,
        tick_s: float = 0.01,
        epsg: int | None = None,
    ) -> None:
        self.site = site if isinstance(site, SiteModel) else read_site(_site_files(site), epsg=epsg)
        self.machine = machine if isinstance(machine, MachineModel) else load_machine(machine, attachment)
        if rules is None:
            rules = SHIPPED_SITE_RULES if site == SHIPPED_SITE else "generic"
        self.rules = rules if isinstance(rules, RuleBook) else load_rule_book(rules)
        self.guard = _guard(guard, guard_parameters or {}) if isinstance(guard, str) else guard
        self.tick_s = tick_s
        self.stand = stand(self.site, self.rules, self.machine, _place(at, self.site))
        position = self.stand.T_absolute_machine[:3, 3]
        self.frame = self.site.frame((float(position[0]), float(position[1]), float(position[2])))
        T = np.array(self.stand.T_absolute_machine)
        T[:3, 3] = self.frame.to_local(position)
        self.limit_set: LimitSet = build_limits(self.site, self.rules, self.frame)
        self.limits = without_own_track(self.limit_set, self.stand.own_track)
        self.off_states: frozenset[str] = frozenset()
        self._scene = Scene(self.machine, self.limits)
        radius_m = max(TICK_RADIUS_M, search_radius_m(self.guard, self.limits))
        self.machine_id = self.machine.name.encode()[:NAME_BYTES].decode(errors="ignore")
        self._config = tick_config(
            self.machine,
            self.guard,
            machine_id=self.machine_id,
            dt_s=tick_s,
            radius_m=radius_m,
            tool_sigma_m=0.0,  # perfect sensors see the attachment where it is
        )
        self._memory = first_memory(self._config)
        self._now_ns = 0
        self._tick_ns = round(tick_s * 1e9)
        self._posture: Posture | None = None
        self._pose: MachinePose | None = None
        q = self._start_posture(T) if posture is None else _posture(self.machine, posture)
        self.truth = GeometricTruth(self.machine, self.limits, TRUTH_RADIUS_M)
        self._refuse_inside(q, T)
        self._readings: list[Reading] = []
        self._plant = KinematicPlant(
            self.machine,
            machine_id=self.machine_id,
            q=q,
            T_site_machine=T,
            substep_s=tick_s / SUBSTEPS,
            on_substep=self._check_truth,
        )

    def _start_posture(self, T_site_machine: Floats) -> Floats:
        """Return home, or a posture clear of the nearest pole that the machine could be driven at."""
        near = nearest_point(self.limits, T_site_machine[:3, 3])
        away = math.inf if near is None else float(np.linalg.norm((near - T_site_machine[:3, 3])[:2]))
        return start_posture(self._scene, T_site_machine, near if away < POLE_WITHIN_M else None)

    @property
    def t_s(self) -> float:
        """Simulated time [s]."""
        return self._now_ns * 1e-9

    @property
    def true_state(self) -> tuple[Floats, Floats]:
        """The true joint positions (n,) and pose of the machine in the site's local frame (4, 4)."""
        q, T = self._plant.truth
        return q, T

    @property
    def tool(self) -> Floats:
        """The true tool centre point (3,) in the site's local frame [m]."""
        q, T = self.true_state
        return np.asarray((T @ self.machine.tool_pose(self.machine.forward(q)))[:3, 3], dtype=np.float64)

    def snapshot(self) -> Snapshot:
        """Return the machine as it truly stands now."""
        q, T = self.true_state
        return snapshot(self.machine, self.truth.look(self._now_ns, q, T, self.off_states), q, T)

    def limit_name(self, limit_id: str) -> str:
        """Return what a person calls a limit."""
        return next((limit.name for limit in self.limits if limit.id == limit_id), limit_id)

    def intent(
        self,
        mode: DriveMode = DriveMode.JOINT,
        levers: Levers | None = None,
        *,
        enable: bool = True,
        line: ToolLine | None = None,
    ) -> Intent:
        """Return an operator's intent, stamped now."""
        stamp = Stamp(self.machine_id, self._now_ns, "operator")
        return Intent(stamp, mode, levers or Levers(), enable, line)

    def step(self, intent: Intent | None = None) -> StepResult:
        """Advance one tick: sensor bytes in, decide, valve bytes out, let the plant move for one period.

        Args:
            intent: what the operator wants, or None if nobody is there (then the machine stops).
        """
        now = self._now_ns
        for chunk in self._plant.read():
            value = decode(chunk.data, now).value
            if isinstance(value, Posture):
                self._posture = value
            elif isinstance(value, MachinePose):
                self._pose = value
        inputs = TickInputs(now, self._posture, self._pose, intent, self._scene, self.off_states)
        began = time.perf_counter_ns()
        outputs, self._memory, trace = tick(inputs, self._memory, self._config)
        tick_ms = (time.perf_counter_ns() - began) * 1e-6
        self._plant.write(outputs.frame)
        self._readings.clear()
        self._plant.advance(self.tick_s)
        truth = min(self._readings, key=lambda one: math.inf if one.limit is None else one.limit.distance_m)
        self._now_ns = now + self._tick_ns
        return StepResult(now * 1e-9, trace, outputs.frame, truth, tick_ms)

    def _check_truth(self, now_ns: int, q: Floats, T_site_machine: Floats) -> None:
        """Take in the truth of one substep."""
        self._readings.append(self.truth.check(now_ns, q, T_site_machine, self.off_states))

    def _refuse_inside(self, q: Floats, T_site_machine: Floats) -> None:
        """Take in the truth at the start; refuse a start inside a limit or with links in each other."""
        reading = self.truth.check(0, q, T_site_machine, self.off_states)
        for found in (reading.limit, reading.own):
            if found is not None and found.distance_m < 0:
                own = found.limit.startswith("self:")
                name = f"its own {found.limit.removeprefix('self:')}" if own else self.limit_name(found.limit)
                raise ScenarioError(
                    f"the machine starts inside {name} ({found.limit}): its {found.link} is "
                    f"{-found.distance_m:.3f} m deep",
                    element="start",
                    value=self.stand.words,
                    allowed="a place and posture outside every limit",
                )


def _guard(name: str, parameters: Mapping[str, float]) -> Guard:
    """Return the guard of that name with these of its parameters changed."""
    guard: Any = guard_named(name)
    known = [field.name for field in fields(guard)]
    for key in parameters:
        if key not in known:
            raise ScenarioError(
                f"guard {name} has no such parameter", element=key, allowed=", ".join(known) or "none"
            )
    chosen: Guard = replace(guard, **parameters)
    return chosen


def _site_files(site: str | Path | Sequence[str | Path]) -> list[Path]:
    if isinstance(site, str | Path):
        if not Path(site).exists() and str(site) in shipped_names("sites"):
            return list(shipped_site_files(str(site)))
        return [Path(site)]
    return [Path(file) for file in site]


def _place(at: tuple[float, float, float] | OnTrack | OnGround | None, site: SiteModel) -> OnTrack | OnGround:
    if isinstance(at, OnGround) and not max(abs(at.east_m), abs(at.north_m)) <= FARTHEST_M:
        raise ScenarioError(
            "no map has such a place",
            element="start",
            value=f"E {at.east_m:g} N {at.north_m:g}",
            allowed=f"up to {FARTHEST_M:g} m",
        )
    if isinstance(at, OnTrack | OnGround):
        return at
    if at is not None:
        if not all(math.isfinite(value) for value in at):
            raise ScenarioError("the place must be finite numbers", element="at", value=at, allowed="E, N, heading")
        return _place(OnGround(east_m=at[0], north_m=at[1], heading_deg=at[2]), site)
    if not site.alignments:
        raise ScenarioError("say where the machine stands", element="at", allowed="(east, north, heading in degrees)")
    first = site.alignments[0]
    return OnTrack(alignment=first.name, distance_m=0.5 * first.length)


def _posture(machine: MachineModel, given: Mapping[str, float]) -> Floats:
    """Return the start posture: home, with the joints named in `given`.

    Raises:
        ScenarioError: for an unknown joint or a position beyond its limits.
    """
    q = np.array(machine.home)
    for name, position in given.items():
        if name not in machine.joint_names:
            raise ScenarioError(
                "no such joint", element="posture", value=name, allowed=", ".join(machine.joint_names)
            )
        j = machine.joint_names.index(name)
        if not machine.q_min[j] <= position <= machine.q_max[j]:
            unit, factor = ("m", 1.0) if machine.prismatic[j] else ("°", math.degrees(1.0))
            low, high = machine.q_min[j] * factor, machine.q_max[j] * factor
            raise ScenarioError(
                f"joint {name} beyond its limits",
                element="posture",
                value=f"{position * factor:g} {unit}",
                allowed=f"{low:g} to {high:g} {unit}",
            )
        q[j] = position
    return frozen(q)
