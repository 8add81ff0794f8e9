"""The fault table of docs/faults.md: every fault played, what the program did about it, when, and what was true.

`WRITE_FAULT_TABLE=1 pytest -m prove tests/acceptance/test_fault_table.py` writes the page anew.
"""

import functools
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.sensing import FaultChoice, SensorChoice
from workgauge.rehearse.session import Session
from workgauge.rehearse.step_result import StepResult
from workgauge.sim.sensors.faults import FaultKind
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.health import HealthState
from workgauge.values.measurements import Levers
from workgauge.values.reasons import ReasonCode

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
E0, N0 = 25_500_000, 6_700_000
TICK_S = 0.01
ONSET_S = 4.0
AFTER_S = 3.0  # looked on after a fault has ended
LEFT, RIGHT = "left receiver", "right receiver"
RANK = {state: rank for rank, state in enumerate(HealthState)}
NONE = "none"


@dataclass(frozen=True)
class Case:
    """One row: a fault on a machine in a setting."""

    words: str
    faults: tuple[dict[str, Any], ...]
    for_s: float = 3.0
    sensors: dict[str, Any] = field(default_factory=dict)
    where: tuple[str, ...] = ("rails", "ground")
    travel_m_s: float = 0.0
    onset_s: float = ONSET_S
    after_s: float = AFTER_S


def _fault(do: str, **more: Any) -> dict[str, Any]:
    return {"do": do, **more}


#: The jumps lead away from the next track: the machine seems to have room that it has not.
AWAY = [0.5, 0.0, 0.0]

CASES = (
    Case("none: noise as the machine's file has it, white and correlated", ()),
    Case("none: noise white only", (), sensors={"noise": {"correlated": 0.0}}),
    Case("noise of both receivers three times what they state", (), sensors={"noise": {"scale": 3.0}}),
    Case("both receivers float", (_fault("float"),)),
    Case("one receiver float", (_fault("float", receiver=LEFT),)),
    Case("both receivers differential", (_fault("differential"),)),
    Case("both receivers single", (_fault("single"),)),
    Case("no fix for 1 s", (_fault("outage"),), 1.0),
    Case("no fix for 10 s, standing", (_fault("outage"),), 10.0, where=("rails",)),
    Case("no fix for 62 s, standing", (_fault("outage"),), 62.0, where=("rails",)),
    Case("no fix for 4 s, travelling at 0.5 m/s", (_fault("outage"),), 4.0, where=("rails",), travel_m_s=0.5),
    Case("one receiver without a fix", (_fault("outage", receiver=RIGHT),)),
    Case("one receiver silent", (_fault("silence", receiver=RIGHT),)),
    Case("both receivers silent", (_fault("silence"),)),
    Case("both jump by 0.5 m for 0.3 s", (_fault("jump", offset_m=AWAY),), 0.3),
    Case("both jump by 0.5 m for 3 s", (_fault("jump", offset_m=AWAY),)),
    Case("one jumps by 0.3 m", (_fault("jump", receiver=LEFT, offset_m=[0.3, 0.0, 0.0]),)),
    Case("both drift off to 0.5 m in 5 s", (_fault("jump", offset_m=AWAY, ramp_s=5.0),), 6.0),
    Case("one receiver hangs, its clock runs", (_fault("frozen", receiver=LEFT),)),
    Case("both hang, their clocks run", (_fault("frozen"),)),
    Case("both repeat old bytes", (_fault("frozen", clock="stopped"),)),
    Case("antenna cables exchanged", (_fault("swapped"),)),
    Case("antenna 0.2 m from where the file has it", (_fault("antenna_moved", receiver=LEFT, offset_m=[0, 0, 0.2]),)),
    Case("corrections stop", (_fault("correction_age"),), 24.0, where=("rails",)),
    Case("boom sensor silent", (_fault("silence", sensor="boom imu"),)),
    Case("all link sensors silent", (_fault("silence", sensor="all"),)),
    Case("boom sensor jumps by 8°", (_fault("sensor_jump", sensor="boom imu", offset_deg=8.0),)),
    Case("boom sensor off by 2°", (_fault("sensor_jump", sensor="boom imu", offset_deg=2.0),)),
    Case("inclinometer off by 2°", (_fault("sensor_jump", sensor="undercarriage tilt", offset_deg=2.0),)),
    Case("swing encoder off by 2°", (_fault("sensor_jump", sensor="swing encoder", offset_deg=-2.0),)),
    Case("swing encoder hangs while swinging", (_fault("frozen", sensor="swing encoder"),), onset_s=1.0),
    Case("one bit in 1,000 bytes flipped, one byte in 1,000 lost", (_fault("bad_bytes"),)),
    Case("one in 50 bytes flipped, one in 50 lost", (_fault("bad_bytes", flipped=0.02, dropped=0.02),)),
    Case("a second receiver 25 m off in the same stream", (_fault("foreign_receiver", receiver=LEFT, talker="GP"),)),
    Case("bytes 0.1 s late", (_fault("latency", delay_s=0.1),)),
    Case("bytes 0.8 s late", (_fault("latency", delay_s=0.8),)),
    Case("receiver's clock steps by 3 s", (_fault("clock_step", step_s=3.0),), after_s=10.0),
)


@dataclass(frozen=True)
class Row:
    """What came of a fault, in the columns of the table."""

    fault: str
    where: str
    first: str
    first_ticks: str
    worst: str
    worst_ticks: str
    again: str
    clearance: str
    outside: str

    @property
    def line(self) -> str:
        cells = (self.fault, self.where, self.first, self.first_ticks, self.worst, self.worst_ticks)
        return "| " + " | ".join((*cells, self.again, self.clearance, self.outside)) + " |"


@functools.cache
def two_tracks(folder: Path) -> SiteModel:
    """Return a site of two straight tracks, 4.5 m apart, due north."""

    def track(name: str, east: float) -> str:
        line = f"<Line><Start>{N0} {E0 + east}</Start><End>{N0 + 200} {E0 + east}</End></Line>"
        profile = "<Profile><ProfAlign name='p'><PVI>0 20</PVI><PVI>200 20</PVI></ProfAlign></Profile>"
        coordinates = f"<CoordGeom>{line}</CoordGeom>{profile}"
        return f'<Alignments><Alignment name="{name}" staStart="0">{coordinates}</Alignment></Alignments>'

    text = (
        '<?xml version="1.0"?><LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">'
        '<Units><Metric linearUnit="meter" directionUnit="radians"/></Units>'
        '<CoordinateSystem name="ETRS89 / GK25FIN" epsgCode="3879"/>'
        f"{track('Track 1', 0.0)}{track('Track 2', -4.5)}</LandXML>"
    )
    file = folder / "two-tracks.xml"
    file.write_text(text)
    return read_site([file])


@functools.cache
def machine_for(where: str) -> MachineModel:
    machine = load_machine("rre20")
    if where == "rails":
        return machine
    return replace(machine, undercarriage=replace(machine.undercarriage, kind="tracks"))


class Operator:
    """Arms the machine, swings at the next track at full lever, and arms again whenever it was stopped."""

    def __init__(self) -> None:
        self.waited = 0

    def intent(self, session: Session, last: StepResult | None) -> Any:
        codes = set() if last is None else {reason.code for reason in last.trace.reasons}
        if codes & {ReasonCode.GATE_CLOSED, ReasonCode.NOT_NEUTRAL} or last is None or not session.ready:
            self.waited = 0
        self.waited += 1
        enable = self.waited > 10
        levers = Levers(left_x=-1.0) if self.waited > 20 else Levers()
        return session.intent(levers=levers, enable=enable)


def play(case: Case, where: str, folder: Path) -> Row:
    """Play one fault and say what came of it."""
    faults = [{**one, "from_s": case.onset_s, "for_s": case.for_s} for one in case.faults]
    at = OnTrack(alignment="Track 1", distance_m=100.0)
    session = Session(
        two_tracks(folder),
        machine_for(where),
        "finland",
        "linear",
        at if where == "rails" else OnGround(east_m=E0, north_m=N0 + 100.0, heading_deg=0.0),
        sensors=SensorChoice.model_validate({"seed": 5, **case.sensors}),
        faults=TypeAdapter(list[FaultChoice]).validate_python(faults),
    )
    onset, end = round(case.onset_s / TICK_S), round((case.onset_s + case.for_s) / TICK_S)
    operator, last = Operator(), None
    states: list[HealthState] = []
    codes: list[str] = []
    nearest = float("inf")
    for tick in range(end + round(case.after_s / TICK_S)):
        if case.travel_m_s:
            session.travel(case.travel_m_s)
        last = session.step(operator.intent(session, last))
        health = last.known.health
        assert health is not None
        states.append(health.state)
        codes.append(health.reasons[0].code.value if health.reasons else NONE)
        if (tick >= onset or not case.faults) and last.truth.limit is not None:
            nearest = min(nearest, last.truth.limit.distance_m)
    assert HealthState.FIXED in states[:onset], "never got to work"
    return _row(case, where, states, codes, onset, end, nearest, len(session.truth.entries()))


def _row(
    case: Case,
    where: str,
    states: list[HealthState],
    codes: list[str],
    onset: int,
    end: int,
    nearest: float,
    entries: int,
) -> Row:
    usual = HealthState.FIXED
    if not case.faults:
        onset = states.index(usual)
    after = range(onset, len(states))
    first = next((k for k in after if states[k] is not usual), None)
    worst = max(after, key=lambda k: (RANK[states[k]], -k))
    bad = [k for k in after if states[k] is not HealthState.FIXED]
    back = None if bad and bad[-1] == len(states) - 1 else max(end, bad[-1] + 1) if bad else end

    def said(k: int | None) -> str:
        return "none" if k is None or first is None else f"{states[k].value.replace('_', ' ')}: `{codes[k]}`"

    return Row(
        case.words,
        where,
        said(first),
        "" if first is None else str(first - onset),
        said(worst),
        "" if first is None else str(worst - onset),
        "" if first is None else f"{back - end}" if back is not None else "not yet",
        f"{nearest:.2f}",
        "yes" if not entries and nearest > 0.0 else "**no**",
    )


def committed() -> list[str]:
    """Return the rows of the page as it is."""
    _, _, table = PAGE.read_text(encoding="utf-8").partition("<!-- table -->")
    return [line for line in table.partition("<!-- end of table -->")[0].splitlines() if line.startswith("| ")][1:]


def same(row: str, other: str) -> bool:
    """Return whether two rows agree, the clearance to 2 cm."""
    mine, theirs = ([cell.strip() for cell in one.strip("| ").split("|")] for one in (row, other))
    clearance = -2
    close = abs(float(mine.pop(clearance)) - float(theirs.pop(clearance))) <= 0.02
    return close and mine == theirs


@pytest.mark.prove
def test_every_fault_is_met_as_the_page_says(tmp_path: Path) -> None:
    rows = [play(case, where, tmp_path).line for case in CASES for where in case.where]
    if os.environ.get("WRITE_FAULT_TABLE"):
        text = PAGE.read_text(encoding="utf-8")
        head, _, rest = text.partition("<!-- table -->\n")
        _, _, tail = rest.partition("<!-- end of table -->\n")
        titles = (
            "fault",
            "on",
            "first reaction",
            "ticks",
            "worst state",
            "ticks",
            "fixed again",
            "clearance [m]",
            "outside",
        )
        ruler = "|---|---|---|--:|---|--:|--:|--:|---|"
        lines = ["| " + " | ".join(titles) + " |", ruler, *rows]
        body = "\n".join(lines)
        PAGE.write_text(f"{head}<!-- table -->\n{body}\n<!-- end of table -->\n{tail}", encoding="utf-8")
    differing = [(new, old) for new, old in zip(rows, committed(), strict=True) if not same(new, old)]
    assert not differing


#: Quick ones, played on every run of the tests.
QUICK = ("no fix for 1 s", "both jump by 0.5 m for 0.3 s")


@pytest.mark.parametrize("case", [case for case in CASES if case.words in QUICK], ids=lambda case: case.words)
def test_these_are_met_as_the_page_says(case: Case, tmp_path: Path) -> None:
    row = play(case, "rails", tmp_path).line
    (old,) = [line for line in committed() if line.startswith(f"| {case.words} | rails |")]
    assert same(row, old), f"\n{row}\n{old}"


def test_every_kind_of_fault_is_in_the_table() -> None:
    played = {one["do"] for case in CASES for one in case.faults}
    assert played == {kind.value for kind in FaultKind}
    expected = [(case.words, where) for case in CASES for where in case.where]
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in committed()]
    assert [(row[0], row[1]) for row in rows] == expected


def test_the_page_claims_no_more_than_the_table_shows() -> None:
    """Rows in which truth came inside a limit are named on the page as what nothing can see."""
    text = PAGE.read_text(encoding="utf-8")
    _, _, prose = text.partition("<!-- end of table -->")
    for line in committed():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if cells[-1] != "yes":
            assert f"*{cells[0]}*" in prose, line
