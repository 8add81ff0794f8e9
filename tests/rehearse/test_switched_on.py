"""A track that opens around the arm: the way out as a step of a scenario."""

import pytest

from workgauge.rehearse.operator import Operator, View
from workgauge.rehearse.scenario import DriveOut, Hold, StateChange
from workgauge.values.arrays import frozen
from workgauge.values.measurements import DriveMode


def test_the_exit_step_holds_its_lever_forward_for_its_time():
    steps = [Hold(do="hold", for_s=0.1), DriveOut(do="exit", lever=0.7, for_s=1.0)]
    operator = Operator(steps, None, None, None)
    modes = {}
    for k in range(200):
        hands = operator.hands(View(k * 0.01, frozen([0.0]), frozen([[0.0]]), frozen([0.0] * 3), 0.0))
        if hands is None:
            break
        modes.setdefault((hands.mode, hands.levers.right_y), []).append(k)
    assert list(modes) == [(DriveMode.JOINT, 0.0), (DriveMode.EXIT, 0.7)]
    assert len(modes[DriveMode.EXIT, 0.7]) == pytest.approx(100, abs=1)


def test_a_plain_on_in_yaml_is_a_key():
    assert StateChange.model_validate({"at_s": 1.0, "state": "open", True: False}).on is False
