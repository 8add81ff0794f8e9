"""The automatic steps of a drive run ahead of time, each from where the one before it ends."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workgauge.motion.job import Job, JobState
from workgauge.rehearse.auto_steps import GoTo
from workgauge.rehearse.automatic import Automatic, AutoStep, Planned, in_step
from workgauge.rehearse.operator import CAME_EVERY_S
from workgauge.rehearse.preview import Nearest, Preview
from workgauge.rehearse.scenario import Step
from workgauge.rehearse.session import Session
from workgauge.values.errors import ScenarioError

#: Postures told of the swept motion are so far apart [s].
TOLD_EVERY_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class StepPreview:
    """What would become of one step.

    Attributes:
        number: of the step in the drive, counted from 1. do: `go_to` or `follow`. preview: of its jobs.
        notes: what planning says of it.
    """

    number: int
    do: str
    preview: Preview
    notes: tuple[str, ...]

    def words(self, names: Mapping[str, str]) -> str:
        """Return the verdict in one line.

        Args:
            names: limit id to what a person calls it.
        """
        found, verb = self.preview, "reaches" if self.do == "go_to" else "gets through"
        said = f"{verb} in {found.duration_s:.1f} s"
        if not found.completed:
            said = f"does not complete, ends after {found.duration_s:.1f} s: {found.why}"
        closest = "no limit in sight"
        if found.nearest is not None:
            limit, one = found.nearest
            name = names.get(limit, limit)
            inside = one.clearance_m < 0.0
            closest = (
                f"{-one.clearance_m:.2f} m inside {name}" if inside else f"closest {one.clearance_m:.2f} m to {name}"
            )
            closest += f" ({one.link} after {one.at_s:.1f} s)"
        return f"step {self.number}, {self.do}: {said}, {closest}"


@dataclass(frozen=True, slots=True, eq=False)
class DrivePreview:
    """What would become of the automatic steps of a drive.

    Attributes:
        steps: in order; after one that does not complete, none.
        left_out: what was not looked at, in words.
        names: limit id to what a person calls it. joint_names: of the machine.
    """

    steps: tuple[StepPreview, ...]
    left_out: tuple[str, ...]
    names: Mapping[str, str]
    joint_names: tuple[str, ...]

    @property
    def completed(self) -> bool:
        """Whether every automatic step would be done."""
        return all(step.preview.completed for step in self.steps)

    @property
    def words(self) -> tuple[str, ...]:
        """One verdict for each step."""
        return tuple(step.words(self.names) for step in self.steps)

    def as_json(self) -> dict[str, Any]:
        """Return the documented object of `run --preview`."""
        return {
            "completed": self.completed,
            "duration_s": round(sum(step.preview.duration_s for step in self.steps), 3),
            "planned_s": round(sum(step.preview.planned_s for step in self.steps), 3),
            "steps": [self._step(step) for step in self.steps],
            "left_out": list(self.left_out),
        }

    def _step(self, step: StepPreview) -> dict[str, Any]:
        found = step.preview
        order = sorted(found.least.items(), key=lambda one: one[1].clearance_m)
        told = np.unique(
            np.append(np.searchsorted(found.t, np.arange(0.0, float(found.t[-1]), TOLD_EVERY_S)), len(found.t) - 1)
        )
        return {
            "step": step.number,
            "do": step.do,
            "completed": found.completed,
            "state": found.state.value,
            "why": found.why or None,
            "duration_s": round(found.duration_s, 3),
            "planned_s": round(found.planned_s, 3),
            "closest": None if found.nearest is None else self._nearest(*found.nearest),
            "clearances": [self._nearest(*one) for one in order],
            "against": list(found.against),
            "swept": {
                "t_s": found.t[told].round(3).tolist(),
                "joints": {name: found.q[told, j].round(5).tolist() for j, name in enumerate(self.joint_names)},
                "tool_m": found.tool[told].round(4).tolist(),
            },
            "notes": list(step.notes),
        }

    def _nearest(self, limit: str, one: Nearest) -> dict[str, Any]:
        return {
            "limit": limit,
            "name": self.names.get(limit, limit),
            "link": one.link,
            "clearance_m": round(one.clearance_m, 4),
            "at_s": round(one.at_s, 3),
        }


def preview_drive(
    session: Session, steps: Sequence[Step], progress: Callable[[float], None] | None = None
) -> DrivePreview:
    """Return what would become of the automatic steps of a drive, begun from the session's present state.

    Steps of other kinds are left out: each automatic step begins where the last one ended. A goal that is stuck is
    planned round once, as a run does.

    Args:
        session: nothing of it changes. progress: called with the simulated time of the step [s].

    Raises:
        ScenarioError: for a step that cannot be planned, or a drive without automatic steps.
    """
    chosen = [(k, step) for k, step in enumerate(steps, 1) if isinstance(step, AutoStep)]
    if not chosen:
        raise ScenarioError(
            "nothing to preview", element="drive", value="no automatic step", allowed="go_to, follow and grade steps"
        )
    automatic = Automatic(session.machine, session.frame, session.surroundings, session.limit_names, session.site)
    first = automatic.planned(steps, *session.true_state)[chosen[0][0]]
    others = {step.do for step in steps if not isinstance(step, AutoStep) and step.do != "hold"}
    left_out = [f"steps by hand: {', '.join(sorted(others))}"] if others else []
    done: list[StepPreview] = []
    last: Preview | None = None
    for number, step in chosen:
        with in_step(number):
            T = session.true_state[1]
            planned = first if last is None else automatic.begun(step, last.after.q, T)
            last, notes = _previewed(session, automatic, step, planned, last, progress)
        done.append(StepPreview(number, step.do, last, notes))
        if not last.completed:
            later = [str(k) for k, _ in chosen if k > number]
            left_out += [f"step {', '.join(later)}: the one before does not complete"] if later else []
            break
    return DrivePreview(tuple(done), tuple(left_out), session.limit_names, session.machine.joint_names)


def _previewed(
    session: Session,
    automatic: Automatic,
    step: AutoStep,
    planned: Planned,
    before: Preview | None,
    progress: Callable[[float], None] | None,
) -> tuple[Preview, tuple[str, ...]]:
    """Return what would become of a step, and what planning says of it."""
    T = session.true_state[1]

    def run(jobs: Sequence[Job], since: Preview | None, left_s: float) -> Preview:
        after = None if since is None else since.after
        return session.preview(jobs, pace=step.pace, at_most_s=left_s, after=after, progress=progress)

    found = run(planned.jobs, before, step.at_most_s)
    if found.state is not JobState.STUCK or not isinstance(step, GoTo) or not step.plan:
        return found, planned.notes
    around = automatic.around_it(step, found.q[:: -max(round(CAME_EVERY_S / session.tick_s), 1)][::-1], T)
    if isinstance(around, str):
        return replace(found, why=f"{found.why}; no way round: {around}"), planned.notes
    again = run(around.jobs, found, max(step.at_most_s - found.duration_s, session.tick_s))
    return found.then(again), planned.notes
