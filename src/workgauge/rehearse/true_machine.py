"""The machine of a session as it truly is: a simulated one, and all that it comes near to."""

import math

import numpy as np

from workgauge.rehearse.navigation import Source
from workgauge.rehearse.result import Snapshot
from workgauge.rehearse.setting import Setting
from workgauge.rehearse.truth import GeometricTruth, Reading, refuse_inside, snapshot
from workgauge.sim.kinematic import KinematicPlant
from workgauge.values.arrays import Floats

#: Truth checks per tick.
SUBSTEPS = 2

#: How far truth looks round the machine [m]; the guard looks as far as the tick's own radius.
TRUTH_RADIUS_M = 10.0


class TrueMachine:
    """A simulated machine under watch: every substep is taken in, with the work states that are off then.

    Args:
        setting: what the session is about. q: (n,) the posture it starts in.
        source: of sensor bytes, shown every substep; None for perfect sensors.

    Attributes:
        plant: the simulated machine. truth: all that was seen.

    Raises:
        ScenarioError: for a start inside a limit or with links in each other.
    """

    def __init__(self, setting: Setting, q: Floats, source: Source | None) -> None:
        self._setting, self._source = setting, source
        self._tracks = setting.on_tracks
        self._off_states: frozenset[str] = frozenset()  # at the last check
        self._readings: list[Reading] = []
        self.truth = GeometricTruth(setting.machine, setting.limit_set.limits, TRUTH_RADIUS_M)
        first = self.truth.check(0, q, setting.T_site_machine, self._off_states, self._tracks.let_off)
        refuse_inside(first, lambda limit: setting.names.get(limit, limit), setting.stand.words)
        self.plant = KinematicPlant(
            setting.machine,
            machine_id=setting.machine_id,
            q=q,
            place=setting.place,
            acceleration_m_s2=setting.brakes.deceleration_m_s2,
            substep_s=setting.tick_s / SUBSTEPS,
            on_substep=self._substep,
            joints=setting.moving.joints,
        )
        if source is not None:
            source.advance(0, q, setting.T_site_machine)

    @property
    def state(self) -> tuple[Floats, Floats]:
        """Joint positions (n,) and pose in the site's local frame (4, 4)."""
        q, T = self.plant.truth
        return q, T

    @property
    def tool(self) -> Floats:
        """The tool centre point (3,) in the site's local frame [m]."""
        q, T = self.state
        machine = self._setting.machine
        return np.asarray((T @ machine.tool_pose(machine.forward(q)))[:3, 3], dtype=np.float64)

    def advance(self, off_states: frozenset[str]) -> Reading:
        """Let one tick pass; return the substep that came nearest to a limit."""
        self._off_states = off_states
        self._readings.clear()
        self.plant.advance(self._setting.tick_s)
        return min(self._readings, key=lambda one: math.inf if one.limit is None else one.limit.distance_m)

    def reading(self, now_ns: int, off_states: frozenset[str]) -> Reading:
        """Return the truth now: the last substep's, unless what counts was switched since."""
        if self._readings and self._off_states == off_states:
            return self._readings[-1]
        return self._look(now_ns, off_states)

    def snapshot(self, now_ns: int, off_states: frozenset[str]) -> Snapshot:
        """Return the machine as it stands now."""
        return snapshot(self._setting.machine, self._look(now_ns, off_states), *self.state)

    def _look(self, now_ns: int, off_states: frozenset[str]) -> Reading:
        return self.truth.look(now_ns, *self.state, off_states, self._tracks.let_off)

    def _substep(self, now_ns: int, q: Floats, T_site_machine: Floats) -> None:
        """Let the sensors see one substep, and take in its truth."""
        if self._source is not None:
            self._source.advance(now_ns, q, T_site_machine)
        self._tracks = self._setting.standing_on(self._tracks, T_site_machine)
        self._readings.append(self.truth.check(now_ns, q, T_site_machine, self._off_states, self._tracks.let_off))
