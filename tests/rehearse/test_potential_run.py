"""The potential guard on the shipped drive at a pole, and in a log's header."""

import json
from dataclasses import replace

import pytest

from workgauge.guard.giving_way import Variant
from workgauge.guard.potential import Points, PotentialGuard
from workgauge.record.setup import configuration, configured
from workgauge.rehearse.run import open_session, run_scenario
from workgauge.rehearse.scenario_file import load_scenario


def test_the_drive_at_the_pole_ends_before_it_and_is_let_back() -> None:
    run = run_scenario(load_scenario("pole-approach").choosing(guard="potential"))
    assert run.entries == () and run.self_entries == ()
    assert run.min_clearance_m is not None and 0.2 <= run.min_clearance_m <= 0.3
    assert {cause.reason for cause in run.interventions} == {"pushed_away"}
    assert {cause.limit for cause in run.interventions} == {"point:P1-12"}
    assert run.series.q[-1] == pytest.approx(run.series.q[0], abs=1e-3)


@pytest.mark.parametrize(
    "guard", [PotentialGuard(), PotentialGuard(points=Points.PER_LINK, variant=Variant.FIRST_THREE, hold=False)]
)
def test_a_log_s_header_holds_its_settings(guard: PotentialGuard) -> None:
    session = open_session(load_scenario("pole-approach").choosing(guard="potential"))
    config = replace(session.config, guard=guard)
    written = json.loads(json.dumps(configuration(config)))
    assert written["guard"] == "potential"
    assert configured(written, session.machine).guard == guard
