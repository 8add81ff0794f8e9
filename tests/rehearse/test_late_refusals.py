"""What goes wrong with automatic steps once the machine has moved is said, and costs nothing of the run."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from workgauge.rehearse.auto_steps import GoTo
from workgauge.rehearse.automatic import Automatic, Planned
from workgauge.rehearse.operator import Hands, Operator, View
from workgauge.rehearse.scenario import Hold
from workgauge.values.errors import InputError, ScenarioError

GO = GoTo.model_validate({"do": "go_to", "goal": {"at_m": [3.0, 0.0, 1.0]}})
HOLD = Hold(do="hold", for_s=1.0)


def view(t_s: float) -> View:
    return View(t_s, np.zeros(4), np.eye(4), np.zeros(3), 0.0)


def operator(steps: tuple[Any, ...], begun: Any) -> Operator:
    none: Any = None
    automatic: Any = SimpleNamespace(begun=begun)
    return Operator(steps, none, none, automatic)


def test_a_step_that_cannot_begin_where_the_machine_stands_by_then_is_said_and_left_out() -> None:
    def refused(*_: object) -> Planned:
        raise ScenarioError("the goal cannot be reached", element="goal", value="out of reach: by 0.43 m")

    one = operator((HOLD, GO, HOLD), refused)
    assert one.hands(view(0.0)) is not None
    hands = one.hands(view(1.0))
    assert isinstance(hands, Hands) and hands.job is None, "the drive goes on with its next step"
    assert [words for words, _ in one.begun] == ["hold", "go to", "hold"]
    assert len(one.notes) == 1
    assert one.notes[0].startswith("step 2: cannot be done")
    assert "out of reach: by 0.43 m" in one.notes[0]


def test_a_planner_that_is_missing_is_why_there_is_no_way_round(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> Planned:
        raise InputError("a global plan needs OMPL, which is not installed", allowed="install workgauge[plan]")

    monkeypatch.setattr(Automatic, "_through", missing)
    monkeypatch.setattr(Automatic, "_pose", lambda *_: np.eye(4))
    monkeypatch.setattr(Automatic, "_counts", lambda *_: None)
    monkeypatch.setattr("workgauge.rehearse.automatic.reaching", lambda *_: [np.zeros(4)])
    automatic = object.__new__(Automatic)
    automatic._machine = automatic._form = None  # type: ignore[assignment]
    found = automatic.around_it(GO, np.zeros((1, 4)), np.eye(4))
    assert isinstance(found, str)
    assert "OMPL" in found and "workgauge[plan]" in found
