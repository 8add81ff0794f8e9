"""Where the joints come to rest: foretold while the valves are open, kept while what is in flight still acts."""

import numpy as np
import pytest

from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.station.coasting import Coasting
from workgauge.values.measurements import Levers


def driven(joints: str, ticks: int, **levers: float) -> tuple[Session, Coasting, list[np.ndarray]]:
    """A machine driven for so many ticks with Enable pressed; what was foretold after each."""
    loaded = load_scenario("pole-approach").choosing(guard="none", joints=joints)  # type: ignore[arg-type]
    session = open_session(loaded)
    coasting, told = Coasting(session), []
    for tick in range(ticks):
        hands = Levers(**levers) if tick > 5 else Levers()
        done = session.step(session.intent(levers=hands, enable=tick > 2))
        q = session.true_state[0]
        coasting.step(done.trace.valves, q)
        told.append(coasting.rest(q))
    return session, coasting, told


@pytest.mark.parametrize("levers", [{"left_x": 1.0}, {"left_y": -0.6}, {"left_x": -0.5, "right_x": 0.8}])
@pytest.mark.parametrize("ticks", [20, 150])
def test_it_comes_to_rest_where_it_was_foretold(ticks: int, levers: dict[str, float]) -> None:
    session, coasting, told = driven("hydraulic", ticks, **levers)
    begun = session.true_state[0]
    for _ in range(300):
        done = session.step(session.intent(enable=False))
        q = session.true_state[0]
        coasting.step(done.trace.valves, q)
        still = coasting.rest(q)
        assert np.abs(still - told[-1]).max() < 0.02, "also while it still rolls with its valves closed"
    rest = session.true_state[0]
    assert np.abs(rest - begun).max() > 0.01, "it was not at rest when the valves closed"
    assert np.abs(rest - told[-1]).max() < 0.02
    assert np.abs(coasting.rest(rest) - rest).max() < 1e-4


def test_joints_that_follow_at_once_rest_where_they_are() -> None:
    session, _, told = driven("ideal", 40, left_x=1.0)
    assert np.array_equal(told[-1], session.true_state[0])
