"""Goals looked at ahead of time: the same jobs on the same tick, in a process of its own."""

import math

from workgauge.motion.ik.closed_form import closed_form
from workgauge.motion.job import JobState
from workgauge.motion.planning import reaching
from workgauge.rehearse.choices import chosen_guard
from workgauge.rehearse.preview import Preview, preview
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import LoadedScenario
from workgauge.rehearse.station.goals import goal_job
from workgauge.rehearse.station.telling import guard_settings, pose_of, rounded
from workgauge.values.arrays import frozen
from workgauge.values.errors import InputError
from workgauge.values.measurements import Stamp
from workgauge.values.station import Foreseen, PreviewResult, PreviewTask
from workgauge.values.transforms import inverse

#: A goal is reached within this, or not at all [s].
AT_MOST_S = 45.0
#: So many postures of the way are told.
POSTURES = 24
SOURCE = "preview"


class Previewer:
    """Looks at goals in a scenario's surroundings.

    Raises:
        InputError: if the scenario cannot be used.
    """

    def __init__(self, loaded: LoadedScenario) -> None:
        self._session = open_session(loaded)

    @property
    def machine_id(self) -> str:
        """Whose goals."""
        return self._session.machine_id

    def look(self, task: PreviewTask) -> PreviewResult:
        """Return what a goal comes to; one that cannot be looked at is not ready, with why."""
        stamp = Stamp(self._session.machine_id, 0, SOURCE)
        try:
            return PreviewResult(stamp, self._looked(task))
        except (InputError, ValueError) as error:
            return PreviewResult(stamp, Foreseen(task.id, False, str(error), None, task.goal, (), ()))

    def _looked(self, task: PreviewTask) -> Foreseen:
        session = self._session
        if (task.guard, task.settings) != (session.guard.name, guard_settings(session.guard)):
            session.choose_guard(chosen_guard(task.guard, dict(task.settings)))
        job = goal_job(session, task.id, task.goal, task.full)
        assert job.goal is not None, "a goal's job has one"
        place = inverse(pose_of(task.pose)) @ job.goal.T_site_tool
        form = closed_form(session.machine)
        near = reaching(session.machine, form, place, job.goal.orientation, frozen(task.q), restarts=2)
        if isinstance(near, str):
            return Foreseen(task.id, False, f"does not reach: {near}", None, task.goal, (), ())
        seen = preview(
            *(session.config, session.scene, frozen(task.q), pose_of(task.pose)),
            *([job], session.moving.joints),
            off_states=frozenset(task.off_states),
            let_off=frozenset(task.let_off),
            at_most_s=AT_MOST_S,
        )
        step = max(1, math.ceil(len(seen.q) / (POSTURES - 1)))
        shown = [*range(0, len(seen.q) - 1, step), len(seen.q) - 1]
        ready = seen.completed and seen.state is JobState.DONE
        return Foreseen(
            *(task.id, ready, self._words(seen), round(seen.duration_s, 2) if ready else None, task.goal),
            tuple(rounded(seen.q[i], 4) for i in shown),
            tuple(rounded(seen.tool[i], 3) for i in shown),
        )

    def _words(self, seen: Preview) -> str:
        """Return the verdict on one line."""
        names = self._session.limit_names
        nearest = seen.nearest
        near = "nothing near"
        if nearest is not None:
            near = f"closest {nearest[1].clearance_m:.2f} m to {names.get(nearest[0], nearest[0])}"
        if seen.completed:
            return f"reaches in {seen.duration_s:.0f} s, {near}"
        why = seen.why
        for limit, name in names.items():
            why = why.replace(limit, name)
        return f"does not reach: {why or 'it goes no further'}; {near}"
