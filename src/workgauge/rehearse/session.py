"""A machine on a site, advanced one tick at a time: what the command line itself uses."""

import copy
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from workgauge.gauge.rules import RuleBook
from workgauge.guard.api import Guard
from workgauge.guard.travel import Brakes
from workgauge.loop.config import TickConfig
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.loop.warm import warm_up
from workgauge.machine.model import MachineModel
from workgauge.motion.job import Job
from workgauge.motion.looking_ahead import Surroundings
from workgauge.motion.wish import FollowSettings
from workgauge.proximity.scene import Scene
from workgauge.rehearse.belief import Belief
from workgauge.rehearse.hydraulic_choice import Joints
from workgauge.rehearse.navigation import Source
from workgauge.rehearse.preview import LONGEST_S, After, Preview, preview
from workgauge.rehearse.result import Snapshot
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.senses import Senses, senses
from workgauge.rehearse.sensing import FaultChoice, Sensors
from workgauge.rehearse.setting import INTENT_AGE_S, SHIPPED_SITE, Setting, setting_of
from workgauge.rehearse.step_result import Observer, StepResult
from workgauge.rehearse.true_machine import TrueMachine
from workgauge.rehearse.truth import GeometricTruth
from workgauge.rehearse.undercarriage import Undercarriage
from workgauge.sim.sensors.kit import START_UTC
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp, ToolLine
from workgauge.wire.stream import Tally


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
        intent_age_s: oldest intent to move on [s].

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
        intent_age_s: float = INTENT_AGE_S,
    ) -> None:
        about = setting_of(
            *(site, machine, rules, guard, at),
            attachment=attachment,
            guard_parameters=guard_parameters,
            tick_s=tick_s,
            epsg=epsg,
            brakes=brakes,
            joints=joints,
            start_utc=start_utc,
        )
        self.site, self.machine, self.rules = about.site, about.machine, about.rules
        self.tick_s, self.brakes, self.moving, self.start_utc = tick_s, about.brakes, about.moving, start_utc
        self.stand, self.frame, self.limit_set, self.states = about.stand, about.frame, about.limit_set, about.states
        self.machine_id = about.machine_id
        self.off_states: frozenset[str] = frozenset()
        self.checked = False  #: whether a valid start-of-shift check was seen, see `navigation.armed`
        self._follow, self._intent_age_s = follow, intent_age_s
        self._tool_sigma_m = 0.0 if sensors == "perfect" and source is None else None
        self._guarded_by(about)
        self._observers: list[Observer] = []
        self._now_ns, self._tick_ns = 0, round(tick_s * 1e9)
        self.senses: Senses = senses(about, sensors, faults, source)
        self._belief = Belief(about, self.senses)
        self._true = TrueMachine(about, about.posture(posture), self.senses.source)

    def _guarded_by(self, about: Setting) -> None:
        """Set up the tick and the undercarriage for a setting's guard, nothing remembered: the gate is closed."""
        self.setting, self.guard = about, about.guard
        self._config = about.tick_config(self._follow, self._tool_sigma_m, self._intent_age_s)
        self._memory, self._undercarriage = first_memory(self._config), Undercarriage(about)

    def choose_guard(self, guard: Guard) -> None:
        """Let another guard work from the next step on; the enable switch must be let go and pressed again.

        Raises:
            ScenarioError: if a valve is open or the undercarriage moves.
        """
        if any(self._memory.valves) or self.true_travel[0]:
            raise ScenarioError("the guard is chosen while the machine stands still", element="guard")
        self._guarded_by(replace(self.setting, guard=guard))

    @property
    def config(self) -> TickConfig:
        """What the tick is set up with."""
        return self._config

    @property
    def limit_names(self) -> Mapping[str, str]:
        """Limit id to what a person calls it."""
        return self.setting.names

    def surroundings(self) -> Surroundings:
        """Return what stands around the machine now, as planning looks at it."""
        return Surroundings(
            *(self.setting.scene, self.true_state[1], getattr(self.guard, "stop_distance_m", 0.0), self._now_ns),
            *(self.off_states, self.let_off),
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
            *(self._config, self.setting.scene, begin.q, T, jobs, begin.joints),
            off_states=self.off_states,
            let_off=self.let_off,
            now_ns=begin.now_ns,
            pace=pace,
            at_most_s=at_most_s,
            memory=begin.memory,
            progress=progress,
        )

    @property
    def gate_open(self) -> bool:
        """Whether the gate let the last command pass."""
        return self._memory.gate.open

    @property
    def let_off(self) -> frozenset[str]:
        """Tracks whose envelopes are no limit for the machine now."""
        return self._belief.tracks.let_off

    @property
    def scene(self) -> Scene:
        """The limits around the machine, as the tick is given them."""
        return self.setting.scene

    @property
    def truth(self) -> GeometricTruth:
        """Everything the true machine came near to so far."""
        return self._true.truth

    def warm_up(self) -> None:
        """Compile what steps need, if it is not on the disk; nothing of the session changes."""
        warm_up(self._config)
        copy.deepcopy(self.moving.joints).advance(self.tick_s, self.true_state[0])

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
        return self.setting.limits(self.let_off)

    @property
    def true_state(self) -> tuple[Floats, Floats]:
        """The true joint positions (n,) and pose of the machine in the site's local frame (4, 4)."""
        return self._true.state

    @property
    def true_travel(self) -> tuple[float, float]:
        """The true speed [m/s] of the undercarriage and the way it has made, forwards less backwards [m]."""
        return self._true.plant.speed_m_s, self._true.plant.travelled_m

    @property
    def start_along_m(self) -> tuple[float, float] | None:
        """Where on its alignment the machine started [m], and +1 or -1 for facing along or against it, or None."""
        return self._undercarriage.start_along_m

    @property
    def tool(self) -> Floats:
        """The true tool centre point (3,) in the site's local frame [m]."""
        return self._true.tool

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """What became of the sentences and messages of each port; empty where sensors are perfect."""
        return self._belief.navigator.tallies

    @property
    def standing_assumption(self) -> str:
        """What a run without travel takes for granted of its undercarriage."""
        return "The undercarriage stands still."

    @property
    def ready(self) -> bool:
        """Whether posture and position are known and may be used."""
        return self._belief.ready

    @property
    def T_believed(self) -> Floats | None:
        """Where simulated sensors have the machine in the site (4, 4), None where they are perfect or do not know."""
        known, source = self._belief.known.pose, self._belief.source
        return None if source is None or known is None else known.T_site_machine

    @property
    def finished(self) -> bool:
        """Whether nothing more can come; a simulated machine goes on for ever."""
        return False

    def snapshot(self) -> Snapshot:
        """Return the machine as it truly stands now."""
        return self._true.snapshot(self._now_ns, self.off_states)

    def limit_name(self, limit_id: str) -> str:
        """Return what a person calls a limit."""
        return self.limit_names.get(limit_id, limit_id)

    def set_state(self, name: str, on: bool) -> None:
        """Switch a work state (`Track 2 open to traffic`) from the next step on; every state is on at the start.

        Raises:
            ScenarioError: if no limit of the site depends on a state of that name.
        """
        self.check_state(name)
        self.off_states = self.off_states - {name} if on else self.off_states | {name}

    def check_state(self, name: str) -> None:
        """Refuse the name of a work state that no limit of the site depends on, by a `ScenarioError`."""
        self.setting.check_state(name)

    def travel(self, speed_m_s: float, curvature: float = 0.0) -> None:
        """Say how fast the undercarriage is to travel from the next step on, until it is said anew.

        Limits, a closed gate and a lost position leave less of it, see `StepResult.travel`.

        Args:
            speed_m_s: forwards as the machine faces, negative backwards.
            curvature: how it is steered on open ground [1/m], positive left; rails steer themselves.

        Raises:
            ValueError: if either is not a finite number.
        """
        self._undercarriage.ask(speed_m_s, curvature)

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
        now, plant, off = self._now_ns, self._true.plant, self.off_states
        known, let_off = self._belief.take(plant.read(), now, checked=self.checked), self.let_off
        inputs = TickInputs(now, known.posture, known.pose, intent, self.scene, off, let_off, known.health, job)
        began = time.perf_counter_ns()
        outputs, self._memory, trace = tick(inputs, self._memory, self._config)
        tick_ms = (time.perf_counter_ns() - began) * 1e-6
        for observer in self._observers:
            observer(inputs, outputs.frame, trace)
        before = self._true.reading(now, off)
        plant.write(outputs.frame)
        travel = self._undercarriage.allowed(trace, known, self._belief.tracks, gate_open=self._memory.gate.open)
        plant.travel(travel.allowed_m_s, travel.curvature)
        truth = self._true.advance(off)
        self._now_ns = now + self._tick_ns
        return StepResult(
            *(now * 1e-9, trace, outputs.frame, truth, before, known),
            *(self._belief.tracks, travel.made(*self.true_travel), tick_ms),
        )
