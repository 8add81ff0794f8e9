"""A machine on a site, advanced one tick at a time: what the command line itself uses."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from workgauge.gauge.build import LimitSet, build_limits
from workgauge.gauge.following import OnTracks, TrackFollower
from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.rules import RuleBook
from workgauge.guard.api import Guard
from workgauge.guard.travel import Brakes
from workgauge.loop.config import TickConfig, search_radius_m, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import Trace, tick
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.desired import MotionConfig
from workgauge.motion.follow import FollowSettings
from workgauge.motion.job import Job
from workgauge.motion.looking_ahead import Surroundings
from workgauge.proximity.scene import Scene
from workgauge.rehearse.choices import chosen_files, chosen_guard, chosen_place, chosen_posture
from workgauge.rehearse.hydraulic_choice import Joints
from workgauge.rehearse.joints import moving
from workgauge.rehearse.navigation import Known, Source, armed
from workgauge.rehearse.posture import LetOff, start_posture
from workgauge.rehearse.preview import LONGEST_S, After, Preview, preview
from workgauge.rehearse.result import Snapshot
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.senses import Senses, senses
from workgauge.rehearse.sensing import FaultChoice, Sensors
from workgauge.rehearse.start import stand
from workgauge.rehearse.step_result import Observer, StepResult
from workgauge.rehearse.targets import nearest_point
from workgauge.rehearse.travelling import Travel, TravelGround, allowed_travel, believed_place
from workgauge.rehearse.truth import GeometricTruth, Reading, refuse_inside, snapshot
from workgauge.rehearse.ways import RailPlace, way_from
from workgauge.sim.kinematic import KinematicPlant
from workgauge.sim.sensors.kit import START_UTC
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp, ToolLine
from workgauge.values.ports import Chunk
from workgauge.values.transforms import heading_from_yaw
from workgauge.wire.messages import NAME_BYTES
from workgauge.wire.stream import Tally

#: The shipped site, and the rule book it is built to.
SHIPPED_SITE, SHIPPED_SITE_RULES = "double_track", "finland"

#: Truth checks per tick.
SUBSTEPS = 2

#: How far truth looks round the machine [m]; the guard looks as far as the tick's own radius.
TRUTH_RADIUS_M = 10.0

#: A start posture takes the nearest pole into account up to this far away [m].
POLE_WITHIN_M = 15.0

#: How far the tick looks: more than a full-speed stop of a 20 t machine (6.7 m).
TICK_RADIUS_M = 7.0


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
        brakes: of the undercarriage. joints: `ideal`, `hydraulic`, or how they follow their valves.
        sensors: `perfect`, or how the simulated receivers and link sensors of the machine behave; faults: what goes
            wrong with them.
        source: sends the bytes of receivers and sensors in their place (a log, a serial port).
        start_utc: UTC at the start of the simulated time.
        follow: how automatic motion does its jobs; left out, as fits the joints.

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
        guard_parameters: Mapping[str, float | str] | None = None,
        tick_s: float = 0.01,
        epsg: int | None = None,
        brakes: Brakes | None = None,
        joints: Joints = "ideal",
        sensors: Sensors = "perfect",
        faults: Sequence[FaultChoice] = (),
        source: Source | None = None,
        start_utc: datetime = START_UTC,
        follow: FollowSettings | None = None,
    ) -> None:
        self.site = site if isinstance(site, SiteModel) else read_site(chosen_files(site), epsg=epsg)
        self.machine = machine if isinstance(machine, MachineModel) else load_machine(machine, attachment)
        if rules is None:
            rules = SHIPPED_SITE_RULES if site == SHIPPED_SITE else "generic"
        self.rules = rules if isinstance(rules, RuleBook) else load_rule_book(rules)
        self.guard = chosen_guard(guard, guard_parameters or {}) if isinstance(guard, str) else guard
        self.tick_s = tick_s
        self.brakes = brakes or Brakes()
        self.moving = moving(joints, self.machine)
        asked = chosen_place(at, self.site)
        self.stand = stand(self.site, self.rules, self.machine, asked)
        position = self.stand.T_absolute_machine[:3, 3]
        self.frame = self.site.frame((float(position[0]), float(position[1]), float(position[2])))
        self.limit_set: LimitSet = build_limits(self.site, self.rules, self.frame, start_utc)
        self.off_states: frozenset[str] = frozenset()
        self.states = frozenset(one.activity.state for one in self.limit_set.limits if one.activity.state is not None)
        self._scene = Scene(self.machine, self.limit_set.limits)
        self._place = way_from(self.site, self.rules, self.machine, self.frame, asked, self.stand)
        T = self._place.T_site_machine
        self._follower = TrackFollower(self.site, self.rules)
        self._tracks = self._true_tracks = self._standing_on(OnTracks(self.stand.own_track), T)
        self.start_utc = start_utc
        self._configure(sensors, faults, source, follow or FollowSettings(compensate=self.moving.late))
        q = self._start_posture(T) if posture is None else chosen_posture(self.machine, posture)
        self.truth = GeometricTruth(self.machine, self.limit_set.limits, TRUTH_RADIUS_M)
        self._refuse_inside(q, T)
        self._plant = KinematicPlant(
            self.machine,
            machine_id=self.machine_id,
            q=q,
            place=self._place,
            acceleration_m_s2=self.brakes.deceleration_m_s2,
            substep_s=tick_s / SUBSTEPS,
            on_substep=self._substep,
            joints=self.moving.joints,
        )
        if self._source is not None:
            self._source.advance(0, q, T)

    def _configure(
        self, sensors: Sensors, faults: Sequence[FaultChoice], source: Source | None, follow: FollowSettings
    ) -> None:
        """Set up the senses, the tick and what it remembers."""
        radius_m = max(TICK_RADIUS_M, search_radius_m(self.guard, self.limit_set.limits))
        self.machine_id = self.machine.name.encode()[:NAME_BYTES].decode(errors="ignore")
        self._config = tick_config(
            self.machine,
            self.guard,
            machine_id=self.machine_id,
            dt_s=self.tick_s,
            radius_m=radius_m,
            tool_sigma_m=0.0 if sensors == "perfect" and source is None else None,
            drive=self.moving.drive,
            motion=MotionConfig(follow=follow),
        )
        self._memory = first_memory(self._config)
        self._observers: list[Observer] = []
        self._now_ns = 0
        self._tick_ns = round(self.tick_s * 1e9)
        self.senses: Senses = senses(self, sensors, faults, source)
        self._navigator, self._source = self.senses.navigator, self.senses.source
        self._known = Known()
        self.checked = False  # whether a valid start-of-shift check was seen, see `navigation.armed`
        self._readings: list[Reading] = []
        self._wanted_travel = 0.0, 0.0
        self._travel_ground = TravelGround(
            self.machine, self.limit_set.limits, self._follower.tracks, self.brakes, self.guard
        )

    def _start_posture(self, T_site_machine: Floats) -> Floats:
        """Return home, or a posture clear of the nearest pole that the machine could be driven at."""
        near = nearest_point(self.limits, T_site_machine[:3, 3])
        away = math.inf if near is None else float(np.linalg.norm((near - T_site_machine[:3, 3])[:2]))
        around = LetOff(self._scene, self._true_tracks.let_off)
        return start_posture(around, T_site_machine, near if away < POLE_WITHIN_M else None)

    @property
    def config(self) -> TickConfig:
        """What the tick is set up with."""
        return self._config

    @property
    def limit_names(self) -> dict[str, str]:
        """Limit id to what a person calls it."""
        return {limit.id: limit.name for limit in self.limit_set.limits}

    def surroundings(self) -> Surroundings:
        """Return what stands around the machine now, as planning looks at it."""
        return Surroundings(
            *(self._scene, self.true_state[1], getattr(self.guard, "stop_distance_m", 0.0), self._now_ns),
            *(self.off_states, self._tracks.let_off),
        )

    def preview(
        self,
        jobs: Sequence[Job],
        *,
        pace: float = 1.0,
        at_most_s: float = LONGEST_S,
        after: After | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Preview:
        """Return what would become of jobs begun now, the undercarriage standing; nothing of the session changes.

        Args:
            jobs, pace, at_most_s, progress: see `preview.preview`. after: begun where another preview ended, instead.
        """
        q, T = self.true_state
        begin = after or After(q, self._memory, self.moving.joints, self._now_ns)
        return preview(
            *(self._config, self._scene, begin.q, T, jobs, begin.joints),
            off_states=self.off_states,
            let_off=self._tracks.let_off,
            now_ns=begin.now_ns,
            pace=pace,
            at_most_s=at_most_s,
            memory=begin.memory,
            progress=progress,
        )

    @property
    def scene(self) -> Scene:
        """The limits around the machine, as the tick is given them."""
        return self._scene

    def observe(self, observer: Observer) -> None:
        """Hand every tick from now on to an observer, which must not change anything."""
        self._observers.append(observer)

    @property
    def t_s(self) -> float:
        """Simulated time [s]."""
        return self._now_ns * 1e-9

    @property
    def limits(self) -> tuple[Limit, ...]:
        """The limits of the site, without the envelopes of tracks the machine is let off now."""
        let_off = self._tracks.let_off
        return tuple(limit for limit in self.limit_set.limits if limit.own_track_of not in let_off)

    @property
    def true_state(self) -> tuple[Floats, Floats]:
        """The true joint positions (n,) and pose of the machine in the site's local frame (4, 4)."""
        q, T = self._plant.truth
        return q, T

    @property
    def true_travel(self) -> tuple[float, float]:
        """The true speed [m/s] of the undercarriage and the way it has made, forwards less backwards [m]."""
        return self._plant.speed_m_s, self._plant.travelled_m

    @property
    def start_along_m(self) -> tuple[float, float] | None:
        """Where on its alignment the machine started [m], and +1 or -1 for facing along or against it, or None."""
        if not isinstance(self._place, RailPlace):
            return None
        return self._place.distance_m, 1.0 if self._place.forward else -1.0

    @property
    def tool(self) -> Floats:
        """The true tool centre point (3,) in the site's local frame [m]."""
        q, T = self.true_state
        return np.asarray((T @ self.machine.tool_pose(self.machine.forward(q)))[:3, 3], dtype=np.float64)

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """What became of the sentences and messages of each port; empty where sensors are perfect."""
        return self._navigator.tallies

    @property
    def standing_assumption(self) -> str:
        """What a run without travel takes for granted of its undercarriage."""
        return "The undercarriage stands still."

    @property
    def ready(self) -> bool:
        """Whether posture and position are known and may be used."""
        known = self._known
        usable = known.health is None or known.health.state.usable
        return self._source is None or (known.posture is not None and known.pose is not None and usable)

    @property
    def T_believed(self) -> Floats | None:
        """Where simulated sensors have the machine in the site (4, 4), None where they are perfect or do not know."""
        known = self._known.pose
        return None if self._source is None or known is None else known.T_site_machine

    @property
    def finished(self) -> bool:
        """Whether nothing more can come; a simulated machine goes on for ever."""
        return False

    def snapshot(self) -> Snapshot:
        """Return the machine as it truly stands now."""
        q, T = self.true_state
        reading = self.truth.look(self._now_ns, q, T, self.off_states, self._true_tracks.let_off)
        return snapshot(self.machine, reading, q, T)

    def limit_name(self, limit_id: str) -> str:
        """Return what a person calls a limit."""
        return next((limit.name for limit in self.limit_set.limits if limit.id == limit_id), limit_id)

    def set_state(self, name: str, on: bool) -> None:
        """Switch a work state (`Track 2 open to traffic`) from the next step on; every state is on at the start.

        Raises:
            ScenarioError: if no limit of the site depends on a state of that name.
        """
        self.check_state(name)
        self.off_states = self.off_states - {name} if on else self.off_states | {name}

    def check_state(self, name: str) -> None:
        """Refuse the name of a work state that no limit of the site depends on.

        Raises:
            ScenarioError: if it is one, naming those there are.
        """
        if name not in self.states:
            known = ", ".join(repr(state) for state in sorted(self.states)) or "none, no limit depends on a state"
            raise ScenarioError("no limit depends on such a state", element="state", value=name, allowed=known)

    def travel(self, speed_m_s: float, curvature: float = 0.0) -> None:
        """Say how fast the undercarriage is to travel from the next step on, until it is said anew.

        Limits, a closed gate and a lost position leave less of it, see `StepResult.travel`.

        Args:
            speed_m_s: forwards as the machine faces, negative backwards.
            curvature: how it is steered on open ground [1/m], positive left; rails steer themselves.

        Raises:
            ValueError: if either is not a finite number.
        """
        if not (math.isfinite(speed_m_s) and math.isfinite(curvature)):
            raise ValueError(f"travel needs finite numbers, not {speed_m_s} m/s, {curvature} 1/m")
        self._wanted_travel = speed_m_s, curvature

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

    def step(self, intent: Intent | None = None, job: Job | None = None) -> StepResult:
        """Advance one tick: sensor bytes in, decide, valve bytes out, let the plant move for one period.

        Args:
            intent: what the operator wants, or None if nobody is there (then the machine stops).
            job: what automatic motion is to do while the intent asks for it.
        """
        now = self._now_ns
        known = self._navigator.take(self._chunks(now), now, self._follower.track(self._tracks.own))
        self._known = known = armed(known, self.machine, self.checked)
        if known.pose is not None:
            self._tracks = self._standing_on(self._tracks, known.pose.T_site_machine)
        off, let_off = self.off_states, self._tracks.let_off
        inputs = TickInputs(now, known.posture, known.pose, intent, self._scene, off, let_off, known.health, job)
        began = time.perf_counter_ns()
        outputs, self._memory, trace = tick(inputs, self._memory, self._config)
        tick_ms = (time.perf_counter_ns() - began) * 1e-6
        for observer in self._observers:
            observer(inputs, outputs.frame, trace)
        before = self._truth_now()
        self._plant.write(outputs.frame)
        travel = self._drive(trace)
        self._readings.clear()
        self._plant.advance(self.tick_s)
        truth = min(self._readings, key=lambda one: math.inf if one.limit is None else one.limit.distance_m)
        self._now_ns = now + self._tick_ns
        return StepResult(
            now * 1e-9,
            trace,
            outputs.frame,
            truth,
            before,
            known,
            self._tracks,
            travel.made(*self.true_travel),
            tick_ms,
        )

    def _chunks(self, now_ns: int) -> list[Chunk]:
        """Return what arrived: from the plant itself if its sensors are perfect, else from the source."""
        perfect = self._plant.read()
        return perfect if self._source is None else self._source.read(now_ns)

    def _standing_on(self, before: OnTracks, T_site_machine: Floats) -> OnTracks:
        """Return what a machine at this pose stands on."""
        e, n = self.frame.to_absolute(T_site_machine[:3, 3])[:2]
        heading = heading_from_yaw(math.atan2(T_site_machine[1, 0], T_site_machine[0, 0]))
        return self._follower.follow(before, float(e), float(n), heading)

    def _truth_now(self) -> Reading:
        """Return the truth at the step's beginning: the last substep's, unless what counts was switched since."""
        q, T = self.true_state
        if self._readings and self._checked_off == self.off_states:
            return self._readings[-1]
        return self.truth.look(self._now_ns, q, T, self.off_states, self._true_tracks.let_off)

    def _drive(self, trace: Trace) -> Travel:
        """Tell the undercarriage how fast it may go."""
        wanted, curvature = self._wanted_travel
        if not wanted:
            self._plant.travel(0.0, curvature)
            return Travel(curvature=curvature)
        pose, rails = self._known.pose, None
        own = self._follower.track(self._tracks.own)
        if pose is not None and own is not None and isinstance(self._place, RailPlace):
            rails = believed_place(pose, self._place.network, own)
        allowed, reasons = allowed_travel(
            wanted, curvature, trace, self._known, rails, self._travel_ground, self._memory.gate.open
        )
        self._plant.travel(allowed, curvature)
        return Travel(wanted, allowed, curvature=curvature, reasons=reasons)

    def _substep(self, now_ns: int, q: Floats, T_site_machine: Floats) -> None:
        """Let the sensors see one substep, and take in its truth."""
        if self._source is not None:
            self._source.advance(now_ns, q, T_site_machine)
        self._true_tracks = self._standing_on(self._true_tracks, T_site_machine)
        self._checked_off = self.off_states
        self._readings.append(self.truth.check(now_ns, q, T_site_machine, self.off_states, self._true_tracks.let_off))

    def _refuse_inside(self, q: Floats, T_site_machine: Floats) -> None:
        """Take in the truth at the start; refuse a start inside a limit or with links in each other."""
        self._checked_off = self.off_states
        reading = self.truth.check(0, q, T_site_machine, self.off_states, self._true_tracks.let_off)
        refuse_inside(reading, self.limit_name, self.stand.words)
