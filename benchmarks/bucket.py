"""How well a bucket's edge follows a surface: one JSON object with `--json`.

- `corners`: a bucket of one metre at 45 degrees to the fall line, four joints beside six (Makkonen).
- `blending`: on a rough slope at 0.3 m/s all the way, the largest joint acceleration from one control period to the
  next, with orientation and way blended over the edges crossed and without.
- `driven` (`--drive`, minutes): the scenario `grade-surface`: control error (the edge against where the plan has it)
  and the true edge against the design, joints hydraulic, sensors perfect; and its first cut with
  sensors by their data sheets, three seeds.
"""

import argparse
import dataclasses
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.bucket.edge import Bucket
from workgauge.motion.bucket.reach import edge_error, followed_from
from workgauge.motion.bucket.surface_path import Blend, surface_path
from workgauge.rehearse.auto_steps import GradeSurface
from workgauge.rehearse.run import run_scenario
from workgauge.rehearse.scenario import Scenario
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.laid import LaidPart, laid
from workgauge.site.surface.tin import Tin

HERE, ORIGIN = np.eye(4), np.zeros(3)
SPEED_M_S, TICK_S = 0.3, 0.01
#: As good as none: the edges crossed are turned over within a millimetre.
UNBLENDED = Blend(turn_m=1e-3, corner_m=2e-5, over_dig_m=None)


def four_jointed() -> MachineModel:
    """Return the excavator with tilt and rotation locked in the middle: four joints."""
    machine = load_machine("rre20")
    given = {f.name: getattr(machine, f.name) for f in dataclasses.fields(machine) if f.init}
    rest = np.eye(4)
    for joint in machine.chain[4:]:
        rest = rest @ joint.T_parent_joint @ joint.T_joint_link
    for name in (
        "joint_names",
        "levers",
        "lever_signs",
        "stopping_positive",
        "stopping_negative",
        "cylinders",
        "chain",
    ):
        given[name] = given[name][:4]
    for name in ("q_min", "q_max", "continuous", "prismatic", "speed_positive", "speed_negative", "home"):
        given[name] = given[name][:4].copy()
    given.update(link_names=machine.link_names[:5], T_link_tool=rest @ machine.T_link_tool)
    given.update(solids=tuple(s for s in machine.solids if s.link <= 4), self_pairs=(), skipped_pairs=())
    return MachineModel(**{**given, "positioning": None, "sensors": (), "pump": None})


def corners() -> list[dict[str, float]]:
    """Return how far the ends of a metre's edge are off at 45 degrees to fall lines of 1:3 and 1:1.5."""
    rows = []
    for one_in in (3.0, 1.5):
        way = np.sqrt(0.5) / one_in * np.ones(2)
        plan = np.array([[-20.0, -20.0], [20, -20], [20, 20], [-20, 20]])
        tin = Tin(np.column_stack([plan, plan @ way - 4.5 / one_in]), [[0, 1, 2], [0, 2, 3]])
        (part,) = laid(tin, [[6.8, 0.0], [5.6, 0.0]]).parts
        made = surface_path(tin, part, Bucket(1.0), Blend(over_dig_m=None), ORIGIN)
        row = {"fall_one_in": one_in, "upright_by_0.5_sin_45_over_fall_m": round(0.5 * math.sqrt(0.5) / one_in, 4)}
        for name, machine in (("four_joints_m", four_jointed()), ("six_joints_m", load_machine("rre20"))):
            found, _, why = followed_from(machine, made.path, HERE, machine.home)
            assert found is not None, why
            row[name] = round(edge_error(machine, found, 1.0).corner_m, 6)
        rows.append(row)
    return rows


def rough_line() -> tuple[Tin, LaidPart]:
    """Return a rough slope and a line on it."""
    rng = np.random.default_rng(5)
    axis = np.arange(-2.0, 12.0, 1.3)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis - 5.0))
    made = triangulated(np.column_stack([x, y, -1.5 + 0.2 * x + 0.1 * y + rng.uniform(-0.05, 0.05, len(x))]))
    tin = Tin(made.vertices, made.faces)
    (part,) = laid(tin, [[7.3, 0.0], [4.9, 0.0]]).parts
    return tin, part


def blending() -> dict[str, Any]:
    """Return the largest joint accelerations at an even speed, with and without blending."""
    machine = load_machine("rre20")
    tin, part = rough_line()
    result: dict[str, Any] = {"edges_crossed": len(part.points) - 2, "speed_m_s": SPEED_M_S}
    for name, blend in (("blended", dataclasses.replace(Blend(), over_dig_m=None)), ("not_blended", UNBLENDED)):
        made = surface_path(tin, part, Bucket(), blend, ORIGIN)
        found, _, why = followed_from(machine, made.path, HERE, machine.home)
        assert found is not None, why
        s = np.arange(0.01, found.length_m - 0.01, SPEED_M_S * TICK_S)
        q = found.curve.at(s)[0]
        acceleration = np.abs(np.diff(q, n=2, axis=0)).max(axis=0) / TICK_S**2
        result[name] = {
            "largest_rad_s2": round(float(acceleration.max()), 3),
            "joint": machine.joint_names[int(acceleration.argmax())],
            "turned_from_a_triangle_by_up_to_deg": round(math.degrees(made.turned_rad), 3),
        }
    result["times_less"] = round(result["not_blended"]["largest_rad_s2"] / result["blended"]["largest_rad_s2"], 1)
    return result


def driven(seed: int | None, folder: Path) -> dict[str, Any]:
    """Return what `grade-surface` comes to, joints hydraulic; with a seed its first cut alone, on noisy sensors."""
    loaded = load_scenario("grade-surface")
    scenario = loaded.scenario
    if seed is not None:
        content = scenario.model_dump(mode="json", exclude_unset=True)
        content["sensors"] = {"noise": "datasheet", "seed": seed}
        content["drive"][0]["for_s"] = 5.0
        content["drive"][1]["fan"].update(to_deg=content["drive"][1]["fan"]["from_deg"], count=1)
        scenario = Scenario.model_validate(content)
        # the guard takes off what the sensors do not know, a quarter of a metre: the limit lies lower by as much
        rules = folder / "rules.yaml"
        rules.write_text(Path(loaded.rules).read_text().replace("lowered_m: 0.55", "lowered_m: 0.80"))
        loaded = dataclasses.replace(loaded, rules=rules)
    result = run_scenario(dataclasses.replace(loaded, scenario=scenario))
    assert result.automatic is not None and result.dug is not None
    cuts = [job for job in result.automatic.jobs if job.job.startswith("cut ")]
    step = scenario.drive[1]
    assert isinstance(step, GradeSurface)
    off = result.dug.left_m - step.above_mm * 1e-3
    return {
        "sensors": "perfect" if seed is None else f"data sheet, seed {seed}",
        "completed": result.automatic.completed,
        "control_error_rms_m": [round(job.rms_error_m, 4) for job in cuts],
        "control_error_largest_m": [round(job.max_error_m, 4) for job in cuts],
        "held_s": [round(job.held_s, 2) for job in cuts],
        "true_edge_off_its_height_rms_m": round(float(np.sqrt(np.nanmean(off**2))), 5),
        "true_edge_off_its_height_mean_m": round(float(np.nanmean(off)), 5),
        "edge_against_design": result.dug.as_json(),
        "entries": len(result.entries),
        "position_error_m": None
        if result.position is None
        else result.position.as_json(result.tick_s)["largest_position_error_m"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--drive", action="store_true", help="drive grade-surface as well")
    given = parser.parse_args()
    result: dict[str, Any] = {"corners": corners(), "blending": blending()}
    if given.drive:
        with tempfile.TemporaryDirectory() as folder:
            result["driven"] = [driven(seed, Path(folder)) for seed in (None, 1, 2, 3)]
    print(json.dumps(result, indent=2 if given.json else None))


if __name__ == "__main__":
    main()
