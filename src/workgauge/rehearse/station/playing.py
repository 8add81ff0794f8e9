"""A scenario's own drive, played tick by tick on a station."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from workgauge.motion.job import Job, JobFacts
from workgauge.rehearse.operator import Operator, View
from workgauge.rehearse.run import planned_drive
from workgauge.rehearse.scenario import Scenario, StateChange
from workgauge.rehearse.session import Session
from workgauge.rehearse.targets import Targets
from workgauge.rehearse.travelling import Driver
from workgauge.values.arrays import Floats
from workgauge.values.measurements import Intent


class Played(NamedTuple):
    """What the scenario wants in this tick."""

    intent: Intent
    job: Job | None


class Player:
    """Goes through a scenario's drive on a fresh session; automatic steps are planned here, before anything moves.

    Raises:
        ScenarioError: if a step cannot be done.
    """

    def __init__(self, session: Session, scenario: Scenario) -> None:
        self._session = session
        automatic, self.notes = planned_drive(session, scenario.drive)

        def nearest_of_all() -> Floats | None:
            return session.snapshot().point_limit

        targets = Targets(session.limits, session.frame, nearest_of_all)
        self._operator = Operator(scenario.drive, session.machine, targets, automatic)
        along_m, facing = session.start_along_m or (None, 1.0)
        self._driver = Driver(scenario.travel, along_m, facing, session.brakes)
        for change in scenario.states:
            session.check_state(change.state)
        self._switches: list[StateChange] = sorted(scenario.states, key=lambda one: one.at_s)
        self._before = self._over_machine()
        self._steps: Sequence[object] = scenario.drive

    @property
    def words(self) -> str:
        """The step in progress, in words."""
        operator = self._operator
        if not operator.begun:
            return ""
        return f"step {operator.step + 1} of {len(self._steps)}: {operator.begun[-1][0]}"

    def next(self, job: JobFacts | None) -> Played | None:
        """Return what the scenario wants in the coming tick, or None when it is over."""
        session = self._session
        while self._switches and self._switches[0].at_s <= session.t_s + 1e-9:
            change = self._switches.pop(0)
            session.set_state(change.state, change.on)
        q, T = session.true_state
        here = self._over_machine()
        speed = float(np.linalg.norm(here - self._before)) / session.tick_s
        self._before = here
        view = View(session.t_s, q, T, session.tool, speed, session.ready, not self._driver.over, job)
        hands = self._operator.hands(view)
        if hands is None:
            session.travel(0.0)
            return None
        speed_m_s, travelled_m = session.true_travel
        session.travel(*(self._driver.wants(session.t_s, travelled_m, speed_m_s) if hands.enable else (0.0, 0.0)))
        return Played(session.intent(hands.mode, hands.levers, enable=hands.enable, line=hands.line), hands.job)

    def _over_machine(self) -> Floats:
        """Return the tool as seen from the undercarriage."""
        T = self._session.true_state[1]
        return np.asarray(T[:3, :3].T @ (self._session.tool - T[:3, 3]), dtype=np.float64)
