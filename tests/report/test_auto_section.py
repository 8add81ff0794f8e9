"""The page's sections on automatic motion: what they say of a run that gave way, and where they draw it."""

import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workgauge.motion.job import JobState
from workgauge.rehearse.auto_series import AutoSeries, JobRun
from workgauge.rehearse.result import Entry, Intervention, RunResult, TravelSeries
from workgauge.report.auto_figures import joint_figures, tool_figures
from workgauge.report.auto_section import JOB_COLUMNS, automatic_section, job_row
from workgauge.report.auto_views import way_from_above, way_from_side
from workgauge.report.figures import clearance_figure
from workgauge.report.giving_way import held_by, off_path
from workgauge.report.page import render
from workgauge.report.verdict import details, headline
from workgauge.report.views import HEIGHT, WIDTH
from workgauge.values.transforms import rotation_z, translation

HELD_BY = ("track:Track 2", "self:undercarriage")
POINTS = re.compile(r'class="toolpath" d="M([^"]*)"')


def gives_way(start: float, end: float, limit: str = "track:Track 2", scale: float = 0.2) -> Intervention:
    return Intervention(start, end, "gives_way", "arm", limit, None, None, scale, f"gives way before {limit}")


@pytest.fixture
def automatic(run: RunResult) -> RunResult:
    """Return a run whose tool, after a first job, is held off its path by Track 2 and then by the undercarriage."""
    n, t = len(run.series), run.series.t_s
    T = translation(100.0, 50.0, 3.0) @ rotation_z(math.pi / 2)
    which = np.where((t >= 1.0) & (t < 2.0), 0, np.where((t >= 2.0) & (t < 8.0), 1, -1))
    driven = np.zeros((n, 6))
    driven[:, :3] = (run.series.tool - T[:3, 3]) @ T[:3, :3]
    error = np.where((t >= 3.0) & (t < 5.0), 0.4 * np.sin(np.pi * (t - 3.0) / 2.0), 0.0)
    designed = driven + np.column_stack([error, np.zeros((n, 5))])
    designed[which < 0] = np.nan
    driven[:, 5] += 2 * np.pi  # another turn of the same angle
    off = np.where(which >= 0, error, np.nan)
    turned = np.where(which >= 0, 0.1 * error, np.nan)
    ones = np.where(which >= 0, 1.0, np.nan)
    jobs = (
        JobRun("to the path 1", JobState.DONE, 0.9, 1.0, 1.99, 0.01, 0.005, 0.01, 0.0, (), 1),
        JobRun(
            "path 2", JobState.DONE, 5.0, 2.0, 7.99, 0.4, 0.1, 0.04, 2.0, ("track:Track 2", "self:undercarriage"), 1
        ),
    )
    joints = np.where(which[:, None] >= 0, run.series.q + 0.02, np.nan)
    auto = AutoSeries(jobs, which, designed, driven, joints, off, turned, ones, ones, T)
    causes = (gives_way(3.0, 4.5), gives_way(4.5, 5.0, "self:undercarriage", 0.5))
    return replace(run, automatic=auto, interventions=causes)


def with_jobs(run: RunResult, *jobs: JobRun) -> RunResult:
    assert run.automatic is not None
    return replace(run, automatic=replace(run.automatic, jobs=jobs))


def test_the_headline_says_how_long_and_how_far_it_gave_way(automatic: RunResult) -> None:
    words, good = headline(automatic)
    assert words == "Done in 7.0 s, 1.18 of the planned time; gave way before Track 2 by up to 0.40 m."
    assert good
    assert 'class="verdict"' in render(automatic)


def test_a_run_that_nothing_held_says_so(automatic: RunResult) -> None:
    assert headline(replace(automatic, interventions=()))[0].endswith("planned time; no limit held it.")
    slowed = replace(automatic, interventions=(gives_way(6.0, 7.0),))
    assert headline(slowed)[0].endswith("; slowed by Track 2, but never off its path.")


def test_a_goal_without_a_plan_has_no_planned_time_and_no_path_to_be_off(automatic: RunResult) -> None:
    assert automatic.automatic is not None
    goal = with_jobs(automatic, *(replace(job, planned_s=math.nan) for job in automatic.automatic.jobs))
    assert headline(goal)[0] == "Done in 7.0 s; held for 1.5 s by Track 2."
    assert goal.automatic is not None and np.isnan(off_path(goal.automatic)).all()
    page = render(goal)
    assert "designedpath" not in page.split("</style>")[1]


def test_stuck_says_when_where_and_before_what(automatic: RunResult) -> None:
    assert automatic.automatic is not None
    first, second = automatic.automatic.jobs
    stuck = with_jobs(automatic, first, replace(second, state=JobState.STUCK, ended_s=4.0))
    why = replace(gives_way(3.9, 4.0, "self:undercarriage", 0.0), reason="stuck")
    stuck = replace(stuck, interventions=(*stuck.interventions, why))
    words, good = headline(stuck)
    assert words == "Stuck at 4.0 s: path 2 came no nearer, the arm before its own undercarriage, 0.00 m off."
    assert not good
    assert 'class="verdict bad"' in render(stuck)


def test_out_of_time_is_not_called_stuck(automatic: RunResult) -> None:
    assert automatic.automatic is not None
    first, second = automatic.automatic.jobs
    late = with_jobs(automatic, first, replace(second, state=JobState.HELD))
    assert headline(late) == ("Not done: path 2 ran out of time at 8.0 s, 0.00 m off.", False)


def test_a_way_round_that_is_done_makes_up_for_being_stuck(automatic: RunResult) -> None:
    assert automatic.automatic is not None
    first, second = automatic.automatic.jobs
    stuck = replace(first, state=JobState.STUCK)
    assert with_jobs(automatic, stuck, second).automatic.completed  # type: ignore[union-attr]
    assert not with_jobs(automatic, stuck, replace(second, step=2)).automatic.completed  # type: ignore[union-attr]


def test_an_entry_comes_first_and_the_jobs_after_it(automatic: RunResult, entry: Entry) -> None:
    bad = replace(automatic, entries=(entry,), min_clearance_m=-0.031)
    assert headline(bad)[0].startswith("The arm entered Pole 12")
    assert "Done in 7.0 s" in details(bad)


def test_what_held_is_named_with_its_time_and_how_far_off(automatic: RunResult) -> None:
    track, own = held_by(automatic)
    assert (track.limit, own.limit) == ("track:Track 2", "self:undercarriage")
    assert track.seconds == pytest.approx(1.5, abs=1e-6) and own.seconds == pytest.approx(0.5, abs=1e-6)
    assert track.off_m == pytest.approx(0.4, abs=1e-3) and track.at_s == pytest.approx(4.0, abs=0.02)
    assert own.off_m == pytest.approx(0.4 * math.sin(math.pi * 0.75), abs=0.01)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_held_tick_has_one_limit_as_counted_tick_by_tick(automatic: RunResult, data: st.DataObject) -> None:
    run = automatic
    tick = st.integers(0, 899)
    names = ("track:Track 2", "point:Pole 12", "self:cab")
    drawn = st.builds(
        lambda a, b, limit, scale, said: replace(
            gives_way(min(a, b) * 0.01, (max(a, b) + 1) * 0.01, limit, scale),
            reason="gives_way" if said else "limit_near",
        ),
        *(tick, tick, st.sampled_from(names), st.floats(0.0, 1.0), st.booleans()),
    )
    causes = data.draw(st.lists(drawn, max_size=5))
    given_run = replace(run, interventions=tuple(causes))
    auto = given_run.automatic
    assert auto is not None
    expected: dict[str, list[int]] = {}
    for k in range(len(run.series)):
        if auto.which[k] < 0:
            continue
        here = [c for c in causes if round(c.t_s * 100) <= k < round(c.until_s * 100)]
        if here:
            most = max(here, key=lambda c: (c.reason == "gives_way", -(c.scale or 0.0)))
            rivals = {c.limit for c in here if (c.reason, c.scale) == (most.reason, most.scale)}
            if len(rivals) == 1:
                expected.setdefault(str(most.limit), []).append(k)
            else:
                return  # a tie may go to either
    found = {one.limit: one for one in held_by(given_run)}
    assert set(found) == set(expected)
    for limit, ticks in expected.items():
        assert found[limit].off_m == pytest.approx(max(float(auto.error_m[k]) for k in ticks))
        covered = [k for k in range(900) if any(a <= (k + 0.5) * 0.01 <= b for a, b in found[limit].spans)]
        assert set(ticks) <= set(covered)
        assert (covered[0], covered[-1]) == (ticks[0], ticks[-1])
        gaps = np.diff(sorted(ticks))
        assert len(found[limit].spans) == 1 + int((gaps > 26).sum())


def test_every_picture_is_well_formed_and_finite(automatic: RunResult) -> None:
    pictures = re.findall(r"<svg.*?</svg>", automatic_section(automatic), flags=re.DOTALL)
    assert len(pictures) == 2 + 3 + 6 + len(automatic.joint_names)
    for picture in pictures:
        ElementTree.fromstring(picture)
        assert "nan" not in picture and "inf" not in picture


def test_the_ways_are_drawn_where_they_are(automatic: RunResult) -> None:
    """The designed way is the driven one moved by 0.4 m along the machine's x axis, which is north here."""
    picture = way_from_above(automatic, automatic.automatic)  # type: ignore[arg-type]
    driven = max(POINTS.findall(picture), key=len)
    designed = max(re.findall(r'class="designedpath" d="M([^"]*)"', picture), key=len)
    a, b = (np.array([list(map(float, pair.split())) for pair in way.split("L")]) for way in (driven, designed))
    metre = _pixels_per_metre(picture)
    gap = (b - a) / metre
    assert gap[:, 0] == pytest.approx(np.zeros(len(gap)), abs=0.2 / metre)
    assert gap[:, 1].min() == pytest.approx(-0.4, abs=0.2 / metre)
    assert ((a > 0) & (a < [WIDTH, HEIGHT])).all()
    assert "0.40 m off" in picture


def _pixels_per_metre(picture: str) -> float:
    bar = re.search(r'class="scalebar" d="M18 [\d.]+V[\d.]+H([\d.]+)V', picture)
    words = re.search(r">([\d.]+) m</text>\s*<g|>([\d.]+) m</text>\s*</svg>", picture)
    assert bar is not None and words is not None
    return (float(bar.group(1)) - 18.0) / float(words.group(1) or words.group(2))


def test_a_machine_that_travels_has_no_one_place_to_draw_its_ways_from(automatic: RunResult, run: RunResult) -> None:
    n = len(run.series)
    travel = TravelSeries(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, 2)), ("Track 1",) * n)
    assert "designedpath" not in automatic_section(replace(automatic, travel=travel))


def test_a_run_that_never_gave_way_is_drawn_whole(automatic: RunResult) -> None:
    auto = automatic.automatic
    assert auto is not None
    same = replace(auto, designed=np.where(auto.which[:, None] >= 0, auto.driven, np.nan), error_m=0.0 * auto.error_m)
    picture = way_from_side(replace(automatic, automatic=same), same)
    assert " off</text>" not in picture and "joined" not in picture
    ElementTree.fromstring(picture)


def test_lagging_behind_is_not_called_giving_way(automatic: RunResult) -> None:
    auto = automatic.automatic
    assert auto is not None
    t = automatic.series.t_s
    late = np.where((t >= 6.0) & (t < 7.0), 0.9, auto.error_m)
    picture = way_from_above(automatic, replace(auto, error_m=late))
    assert "0.40 m off" in picture
    alone = replace(automatic, interventions=())
    assert " off</text>" not in way_from_above(alone, auto) + way_from_side(alone, auto)
    assert "where it gave way; limits" in automatic_section(automatic)
    assert "where it gave way; limits" not in automatic_section(alone)


def test_the_same_angle_in_another_turn_is_drawn_on_the_designed_one(automatic: RunResult) -> None:
    yaw = tool_figures(automatic, automatic.automatic, ())[5]  # type: ignore[arg-type]
    rows = {}
    for name in ("driven", "designed"):
        points = " ".join(re.findall(rf'line {name}" points="([^"]*)"', yaw)).split()
        rows[name] = {float(pair.split(",")[1]) for pair in points}
    assert rows["driven"] == rows["designed"]


def test_joints_that_slide_are_told_in_millimetres(automatic: RunResult) -> None:
    sliding = replace(automatic, prismatic=(False, True, *automatic.prismatic[2:]))
    figures = joint_figures(sliding, sliding.automatic, ())  # type: ignore[arg-type]
    assert "swing [°]" in figures[0] and "boom [mm]" in figures[1]


def test_the_table_has_a_row_for_every_job(automatic: RunResult) -> None:
    assert automatic.automatic is not None
    for job in automatic.automatic.jobs:
        cells = job_row(automatic, job)
        assert len(cells) == len(JOB_COLUMNS)
        for cell in cells:
            assert f">{cell}</td>" in automatic_section(automatic)
    assert cells[-1] == "Track 2, its own undercarriage"


def test_names_cannot_break_the_page(automatic: RunResult) -> None:
    assert automatic.automatic is not None
    evil = "<script>alert(1)</script>&\"'"
    jobs = tuple(replace(job, job=evil) for job in automatic.automatic.jobs)
    page = render(replace(with_jobs(automatic, *jobs), limit_names={"track:Track 2": evil}))
    assert "<script" not in page
    for picture in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL):
        ElementTree.fromstring(picture)


def test_without_automatic_motion_nothing_is_said_of_it(run: RunResult) -> None:
    assert automatic_section(run) == ""
    assert "Automatic motion" not in render(run)
    assert held_by(run) == ()


def test_own_links_are_among_the_clearances_where_they_held_the_machine(automatic: RunResult, run: RunResult) -> None:
    assert "its own links" in clearance_figure(automatic)
    assert "its own links" not in clearance_figure(run)


def test_json_has_exactly_the_documented_keys(automatic: RunResult) -> None:
    found = automatic.as_json()["automatic"]
    assert list(found) == ["completed", "planned_s", "driven_s", "driven_over_planned", "jobs"]
    keys = "job step state planned_s begun_s driven_s max_error_m rms_error_m max_error_deg held_s against"
    assert [" ".join(job) for job in found["jobs"]] == [keys, keys]
    assert found["jobs"][0]["step"] == 2
