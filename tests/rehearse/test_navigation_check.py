"""A session of a machine whose file asks for a start-of-shift check moves nothing before there is one."""

from dataclasses import replace

import pytest

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.navigation import Known, armed
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.reasons import ReasonCode


@pytest.fixture(scope="module")
def asking() -> MachineModel:
    machine = load_machine("rre20")
    assert machine.positioning is not None
    thresholds = machine.positioning.thresholds.model_copy(update={"check_required": True})
    return replace(machine, positioning=machine.positioning.model_copy(update={"thresholds": thresholds}))


@pytest.mark.parametrize("health", [None, PositionHealth(HealthState.FIXED, 5)])
def test_without_a_check_it_stops(asking: MachineModel, health: PositionHealth | None) -> None:
    known = armed(Known(health=health), asking, checked=False)
    assert known.health is not None and known.health.state is HealthState.STOP
    assert known.health.reasons[0].code is ReasonCode.NOT_CHECKED


def test_with_a_check_or_unasked_nothing_changes(asking: MachineModel) -> None:
    known = Known(health=PositionHealth(HealthState.FIXED, 5))
    assert armed(known, asking, checked=True) is known
    assert armed(known, load_machine("rre20"), checked=False) is known
    assert armed(known, load_machine("sun-a"), checked=False) is known
