"""Steps that grade a surface: what they ask for, their strokes, and a drive of one."""

import dataclasses
import itertools
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import yaml

import workgauge
from workgauge.machine.load import load_machine
from workgauge.rehearse.auto_steps import GradeSurface
from workgauge.rehearse.grading import Grading, Lines
from workgauge.rehearse.run import open_session, run_scenario
from workgauge.rehearse.scenario import Scenario
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.site.model import SiteModel, SurfaceModel
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.limits import Source

RULES = Path(workgauge.__file__).parent / "shipped" / "scenarios" / "_grade-surface-rules.yaml"
PLACE = np.array([1000.0, 2000.0, 50.0])


def plane(name: str, height: float = 0.0, tilt: tuple[float, float] = (0.05, -0.04)) -> SurfaceModel:
    xy = np.array([[-12.0, -12.0], [12, -12], [12, 12], [-12, 12]])
    vertices = np.column_stack([xy, xy @ tilt + height]) + PLACE
    return SurfaceModel(
        name, None, None, vertices, np.array([[0, 1, 2], [0, 2, 3]]), 576.0, MappingProxyType({}), Source("f", name)
    )


def site(*surfaces: SurfaceModel) -> SiteModel:
    return SiteModel(crs=None, crs_declared={}, units={}, surfaces=surfaces)


def step(**keys: object) -> GradeSurface:
    lines = (
        {} if {"fan", "along", "side_by_side"} & set(keys) else {"polyline_en_m": [[1006.5, 2000], [1005.5, 2000]]}
    )
    return GradeSurface.model_validate({"do": "grade", **lines, **keys})


def test_strokes_go_down_pass_by_pass_and_end_on_the_design():
    machine = load_machine("rre20")
    grading = Grading(site(plane("design"), plane("ground", 0.25)), PLACE)
    strokes, said = grading.strokes(
        step(surface="design", ground="ground", depth_m=0.1, above_mm=5.0), machine, machine.home, np.eye(4)
    )
    assert [round(one.made.offset_m, 6) for one in strokes] == [0.205, 0.105, 0.005]
    assert all(one.error.corner_m < 1e-3 for one in strokes)
    for before, after in itertools.pairwise(strokes):
        assert after.motions[0].trajectory.q[0] == pytest.approx(before.q_end, abs=1e-9)
    assert said == ()
    depth = grading.tin("design")
    s = np.linspace(0.0, strokes[-1].joints.length_m, 30)
    for q, at in zip(strokes[-1].joints.curve.at(s)[0], s, strict=True):
        tool = machine.tool_pose(machine.forward(q))[:3, 3] + PLACE
        assert tool[2] - depth.heights(tool[None, :2])[0] == pytest.approx(0.005, abs=5e-4), at


def test_passes_too_high_to_reach_are_cut_and_said():
    """Three metres of ground on the design: high passes are shorter, and what they leave is told; low ones whole."""
    machine = load_machine("rre20")
    grading = Grading(site(plane("design", -0.5, (0, 0)), plane("ground", 2.5, (0, 0))), PLACE)
    line = [[1007.3, 2000], [1004.5, 2000]]
    asked = step(polyline_en_m=line, surface="design", ground="ground", depth_m=0.5)
    strokes, said = grading.strokes(asked, machine, machine.home, np.eye(4))
    heights = [one.made.offset_m for one in strokes]
    assert heights == sorted(heights, reverse=True) and heights[0] >= 1.5 and heights[-1] == 0.0
    lengths = {round(one.made.offset_m, 3): one.joints.length_m for one in strokes}
    assert lengths[0.0] == pytest.approx(2.8, abs=1e-3) and min(lengths.values()) < 2.75
    told = [text for text in said if "out of reach so high" in text]
    short = [height for height in (2.5, 2.0, 1.5, 1.0, 0.5) if lengths.get(height, 0.0) < 2.75]
    assert len(told) == len(short) > 0
    for one in strokes:  # joints within their ends, the edge at the height of its pass
        q = one.joints.curve.at(np.linspace(0.0, one.joints.length_m, 15))[0]
        assert (q >= machine.q_min).all() and (q <= machine.q_max).all()
        tools = np.array([machine.tool_pose(machine.forward(row))[2, 3] for row in q])
        assert tools == pytest.approx(one.made.offset_m - 0.5, abs=1e-3)


@pytest.mark.parametrize("above", [0.0, 10.0, 30.0])
def test_room_for_control_errors_is_left_where_the_edges_ends_bind(above):
    """Along a ditch narrower than the bucket: its ends come to rest on the sides, less the room."""
    ditch = plane("design")
    xy = np.array([[x, y] for x in (-12.0, 4.0, 6.0, 8.0, 12.0) for y in (-12.0, 12.0)])
    vertices = np.column_stack([xy, -0.8 * np.maximum(0.0, 1.0 - np.abs(xy[:, 0] - 6.0) / 2.0)]) + PLACE
    faces = np.array([[k, k + 2, k + 3] for k in range(0, 8, 2)] + [[k, k + 3, k + 1] for k in range(0, 8, 2)])
    design = Grading(site(dataclasses.replace(ditch, vertices=vertices, faces=faces)), PLACE)
    machine = load_machine("rre20")
    line = [[1006.0, 1998.8], [1006.0, 2000.8]]
    asked = step(polyline_en_m=line, bucket_width_m=0.8, above_mm=above, over_dig_mm=20.0)
    (one,), said = design.strokes(asked, machine, machine.home, np.eye(4))
    tin, lowest = design.tin(None), []
    for q in one.joints.curve.at(np.linspace(0.0, one.joints.length_m, 40))[0]:
        tool = machine.tool_pose(machine.forward(q))
        edge = tool[:3, 3] + np.linspace(-0.4, 0.4, 17)[:, None] * tool[:3, 0] + PLACE
        lowest.append((edge[:, 2] - tin.heights(edge[:, :2])).min())
    deep = max(20.0 - above, 0.0) * 1e-3
    assert -deep - 1.5e-3 <= min(lowest) <= -0.5 * deep + above * 1e-3
    assert one.made.lift_m > 0.05 and any("lifted" in text for text in said)


def test_a_four_jointed_machines_misfit_is_said():
    machine = load_machine("sun-a")
    grading = Grading(site(plane("design", -0.3, (0.0, 0.2))), PLACE)
    asked = step(polyline_en_m=[[1003.0, 2000], [1002.4, 2000]], over_dig_mm=500.0)
    strokes, said = grading.strokes(asked, machine, machine.home, np.eye(4))
    assert strokes[0].error.corner_m == pytest.approx(0.1 / np.hypot(1, 0.2), rel=0.05)
    assert any("cannot turn the edge" in text for text in said)
    heap = Grading(site(plane("design", -0.3, (0.0, 0.2)), plane("ground", -0.1, (0.0, 0.2))), PLACE)
    asked = step(polyline_en_m=[[1003.0, 2000], [1002.4, 2000]], surface="design", ground="ground", depth_m=0.06)
    strokes, _ = heap.strokes(asked, machine, machine.home, np.eye(4))
    for one, offset in zip(strokes, (0.06, 0.0), strict=True):  # lifted in every pass, by what it cannot turn
        assert one.made.offset_m == pytest.approx(offset)
        q = one.joints.curve.at(np.linspace(0.0, one.joints.length_m, 9))[0]
        tool = np.array([machine.tool_pose(machine.forward(row)) for row in q])
        ends = tool[:, None, :3, 3] + np.array([[-0.5], [0.5]]) * tool[:, None, :3, 0]
        assert (ends[..., 2] - (0.2 * ends[..., 1] - 0.3)).min() == pytest.approx(offset - 0.01, abs=2e-3)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"surface": "road"}, "no such surface"),
        ({"polyline_en_m": [[1050.0, 2000], [1051, 2000]]}, "no part of the line is within reach"),
        ({"polyline_en_m": [[1008.9, 2000], [1008.2, 2000]]}, "no way of the bucket is in reach"),
        ({"along": {"alignment": "Track 9"}}, "no such alignment"),
    ],
)
def test_what_cannot_be_graded_is_refused(keys, words):
    machine = load_machine("rre20")
    with pytest.raises(InputError, match=words):
        Grading(site(plane("design")), PLACE).strokes(step(**keys), machine, machine.home, np.eye(4))


@pytest.mark.parametrize(
    "keys",
    [
        {"fan": {"from_deg": 0, "to_deg": 10}, "side_by_side": {}},
        {"depth_m": 0.1},
        {"ground": "ground"},
        {"polyline_en_m": [[1.0, 2.0]]},
        {"bucket_width_m": 0.0},
        {"speed_m_s": 0.0},
        {"colour": "red"},
    ],
)
def test_steps_that_make_no_sense(keys):
    with pytest.raises(ValueError):
        step(**keys)


@pytest.mark.parametrize(
    ("key", "most", "least"),
    [
        ("bucket_width_m", 20.0, None),
        ("cutting_deg", 80.0, -80.0),
        ("over_dig_mm", 1e4, 0.0),
        ("corner_mm", 1e4, 0.0),
        ("turn_m", 10.0, 1e-3),
    ],
)
def test_what_no_bucket_does_is_refused_by_the_key_written(key, most, least):
    for value in (most, least):
        if value is not None:
            assert getattr(step(**{key: value}), key) == value
    for wrong in (1.01 * most, least - 0.01 if least is not None else 0.0):
        with pytest.raises(ValueError, match=key):
            step(**{key: wrong})


def test_lines_turn_with_the_machine():
    machine = load_machine("rre20")
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = PLACE
    (line,) = Lines(yaws=(0.0,), near_m=4.0, far_m=6.0).in_plan(site(), machine, T)
    assert line == pytest.approx(np.array([[1000.0, 2006.0], [1000.0, 2004.0]]))
    (own,) = Lines(polyline=np.array([[1000.0, 2004.5], [1000.0, 2005.0]])).in_plan(site(), machine, T)
    assert own[0] == pytest.approx([1000.0, 2004.5])  # a line of one's own keeps its direction


def scenario(tmp_path, rules: str, *, surfaces=None, steps=(), top=None, **keys: object):
    rows = [f"{1000 + x} {2000 + y} {50 + 0.05 * x - 0.04 * y}" for x in (-12, 0, 12) for y in (-12, 0, 12)]
    (tmp_path / "slope.xyz").write_text("\n".join(rows))
    content = {
        "title": "grading",
        "site": {"files": ["slope.xyz"]},
        "machine": "rre20",
        "attachment": "ditching bucket",
        "rules": rules,
        "guard": {"name": "barrier"},
        "start": {"on_ground": {"east_m": 1000.0, "north_m": 2000.0, "heading_deg": 90.0}},
        "joints": "ideal",
        "tick_ms": 20,
        "drive": [
            {"do": "hold", "for_s": 0.2},
            {"do": "grade", "polyline_en_m": [[1006.6, 2000.0], [1005.8, 2000.2]], "lift_m": 0.3, **keys},
        ],
    }
    content["drive"][1:2] = [{**content["drive"][1], **one} for one in steps] or content["drive"][1:2]
    for name, f in (surfaces or {}).items():
        rows = [f"{1000 + x} {2000 + y} {f(x, y)}" for x in (-12, 0, 12) for y in (-12, 0, 12)]
        (tmp_path / f"{name}.xyz").write_text("\n".join(rows))
        content["site"]["files"].append(f"{name}.xyz")
    content["start"]["posture_deg"] = {"swing": 0, "boom": 25, "stick": -80, "bucket": -20}
    content |= top or {}
    path = tmp_path / "grading.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_scenario(str(path))


def test_a_drive_leaves_the_design_behind(tmp_path):
    result = run_scenario(scenario(tmp_path, str(RULES)))
    assert result.automatic is not None and result.automatic.completed and not result.entries
    assert [job.job.rsplit(" ", 1)[0] for job in result.automatic.jobs] == [
        "to cut 1",
        "down to cut 1",
        "cut 1",
        "up from cut 1",
    ]
    dug = result.dug
    assert dug is not None and dug.rms_m < 1e-3 and dug.deepest_m < 2e-3 and not dug.over_dug
    assert dug.area_m2 == pytest.approx(np.hypot(0.8, 0.2), abs=0.15)
    assert result.as_json()["dug"]["rms_m"] == round(dug.rms_m, 5)


def test_work_that_outlasts_its_step_is_refused_beforehand(tmp_path):
    with pytest.raises(ScenarioError, match=r"the work takes \d+ s at least.*at_most_s of at least \d+") as refused:
        run_scenario(scenario(tmp_path, str(RULES), at_most_s=5.0))
    assert "step 2" in str(refused.value) and "1 cuts" not in str(refused.value)


def without_the_design_as_limit(tmp_path) -> str:
    book = yaml.safe_load(RULES.read_text())
    book["rules"] = [{**one, "limits": []} if one["name"] == "design-surface" else one for one in book["rules"]]
    path = tmp_path / "rules.yaml"
    path.write_text(yaml.safe_dump(book))
    return str(path)


def lowest_edge(result, session, width=1.0):
    """Return the edge's lowest height above the plane of the tests at every tick (N,), worked out here alone."""
    machine, T, origin = session.machine, session.true_state[1], session.frame.origin
    found = []
    for q in result.series.q:
        tool = T @ machine.tool_pose(machine.forward(q))
        edge = tool[:3, 3] + np.linspace(-0.5 * width, 0.5 * width, 21)[:, None] * tool[:3, 0] + origin
        found.append((edge[:, 2] - (50 + 0.05 * (edge[:, 0] - 1000) - 0.04 * (edge[:, 1] - 2000))).min())
    return np.array(found)


def test_several_passes_meet_the_design_and_never_go_below_it(tmp_path):
    """Ground 0.25 m above the design, 0.1 m a pass, joints hydraulic: from geometry, at every tick."""
    above, deep = 0.010, 0.020
    loaded = scenario(
        tmp_path,
        str(RULES),
        surfaces={"ground": lambda x, y: 50.25 + 0.05 * x - 0.04 * y},
        top={"joints": "hydraulic"},
        surface="slope",
        ground="ground",
        depth_m=0.1,
        above_mm=1e3 * above,
        over_dig_mm=1e3 * deep,
    )
    result = run_scenario(loaded)
    assert result.automatic is not None and result.automatic.completed and not result.entries
    jobs = [job.job.rsplit(" ", 1)[0] for job in result.automatic.jobs]
    cuts = [name for name in jobs if name.startswith("cut")]
    assert cuts == ["cut 1, pass 1", "cut 1, pass 2", "cut 1, pass 3"]
    lowest = lowest_edge(result, open_session(loaded))
    assert lowest.min() >= -deep
    for name, wanted in zip(cuts, (0.2, 0.1, 0.0), strict=True):
        during = lowest[result.automatic.which == jobs.index(name)]
        assert np.abs(during - wanted - above).max() < 0.03  # each pass at its own depth, the last on the design
        assert np.median(during) == pytest.approx(wanted + above, abs=5e-3)
    dug = result.dug
    assert dug is not None and not dug.over_dug and dug.allowed_m == deep
    assert dug.deepest_m == pytest.approx(max(0.0, -lowest.min()), abs=1e-3)
    assert dug.mean_m == pytest.approx(above, abs=5e-3)


def test_every_step_counts_against_its_own_design(tmp_path):
    low = {"surface": "low", "polyline_en_m": [[1006.4, 2001.5], [1005.6, 2001.5]], "over_dig_mm": 5.0}
    loaded = scenario(
        tmp_path,
        without_the_design_as_limit(tmp_path),
        surfaces={"low": lambda x, y: 49.7},
        steps=({"surface": "slope"}, low),
    )
    result = run_scenario(loaded)
    assert result.automatic is not None and result.automatic.completed
    dug = result.dug
    assert dug is not None and not dug.over_dug and dug.deepest_m < 2e-3 and dug.rms_m < 2e-3
    assert dug.area_m2 == pytest.approx(np.hypot(0.8, 0.2) + 0.8, abs=0.3)


def test_ways_there_and_back_count_as_well(tmp_path):
    """A fill 0.5 m above the first design: the second step's bucket comes from under it, though its cut is exact."""
    fill = {"surface": "fill", "polyline_en_m": [[1006.4, 2001.0], [1005.6, 2001.0]]}
    loaded = scenario(
        tmp_path,
        without_the_design_as_limit(tmp_path),
        surfaces={"fill": lambda x, y: 50.5 + 0.05 * x - 0.04 * y},
        steps=({"surface": "slope"}, fill),
    )
    result = run_scenario(loaded)
    assert result.automatic is not None and result.automatic.completed
    jobs = [k for k, job in enumerate(result.automatic.jobs) if job.step == 2]
    lowest = lowest_edge(result, open_session(loaded)) - 0.5
    during = lowest[np.isin(result.automatic.which, jobs)]
    assert during.min() < -0.1
    assert lowest[result.automatic.which == jobs[2]].min() > -2e-3  # the cut
    assert result.dug is not None and result.dug.over_dug
    assert result.dug.deepest_m == pytest.approx(-during.min(), abs=1e-3)


def test_a_surface_that_is_a_limit_itself_refuses_the_work(tmp_path):
    with pytest.raises(ScenarioError, match="through a limit"):
        run_scenario(scenario(tmp_path, "generic"))


def test_with_noisy_sensors_ways_are_planned_from_where_the_machine_is_believed(tmp_path):
    exact = open_session(scenario(tmp_path, str(RULES)))
    assert exact.T_believed is None
    loaded = load_scenario("grade-surface")
    content = loaded.scenario.model_dump(mode="json", exclude_unset=True)
    content["sensors"] = {"noise": "datasheet", "seed": 1}
    session = open_session(dataclasses.replace(loaded, scenario=Scenario.model_validate(content)))
    while session.T_believed is None and session.t_s < 3.0:
        session.step(session.intent(enable=False))
    believed = session.T_believed
    assert believed is not None
    off = np.linalg.norm(believed[:3, 3] - session.true_state[1][:3, 3])
    assert 0.0 < off < 0.3


@pytest.mark.prove
def test_grade_surface_is_never_deeper_than_allowed():
    result = run_scenario(load_scenario("grade-surface"))
    assert result.automatic is not None and result.automatic.completed and not result.entries
    assert result.dug is not None and not result.dug.over_dug
    for job in result.automatic.jobs:
        if job.job.startswith("cut "):
            assert job.rms_error_m <= 0.02
            print(f"\n{job.job}: error {1e3 * job.rms_error_m:.1f} mm RMS, {1e3 * job.max_error_m:.1f} mm largest")
    print(f"deepest {1e3 * result.dug.deepest_m:.1f} mm of {1e3 * result.dug.allowed_m:.0f} allowed")
