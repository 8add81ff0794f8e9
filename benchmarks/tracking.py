"""How closely automatic motion follows a path, and what each part of it is worth.

    python benchmarks/tracking.py --json

Two paths, without a guard and far from every limit: `rre20` round a rectangle of 2 m by 1 m with rounded corners,
upright in front of it, at 0.3 m/s with the whole orientation kept; `brokk5` along the figure of the scenario
`drawn-path` at 0.3 m/s. Each

- with ideal joints;
- with hydraulic joints as the machine's file says, with and without feed-forward, with and without dead time and lag
  being made up for;
- with joints drawn within the file's tolerance (`seed`), while automatic motion goes by the file.

Without dead time being made up for, the gain is lowered so far that the loop bears all of it: 0.75 over dead time and
lag. Errors are those of the true tool from where it was to be by then, on the path alone, without the way to its
beginning. `--machine`, `--joints` and `--seeds` choose less.
"""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.motion.predict import STEADY
from workgauge.motion.wish import FollowSettings
from workgauge.rehearse.auto_steps import FollowPath, PathPoint
from workgauge.rehearse.hydraulic_choice import HydraulicChoice, Joints
from workgauge.rehearse.run import run_session
from workgauge.rehearse.scenario import Hold, OnTrack, Step
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.session import Session

SPEED_M_S = 0.3
TICK_S = 0.01
PLACE = "drawn-path"
#: The excavator reaches too far for that place.
ELSEWHERE = OnTrack(alignment="Track 1", distance_m=100.0)
#: Where the excavator's arm begins, and the rectangle's middle, half sides and corner radius, machine frame [m].
START_DEG = {"swing": 0.0, "boom": 25.0, "stick": -95.0, "bucket": -20.0, "tilt": 0.0, "rotate": 0.0}
MIDDLE, HALF, CORNER_M = (5.0, 0.0, 1.6), (1.0, 0.5), 0.25
#: Bucket straight down, its edge across the view from the cab.
DOWN = (180.0, 0.0, 90.0)


def rectangle() -> FollowPath:
    """Return the way round the rounded rectangle, upright across the machine's view."""
    points = []
    for cy, cz, begin in ((1, 1, 0), (-1, 1, 90), (-1, -1, 180), (1, -1, 270)):
        for angle in np.radians(np.linspace(begin, begin + 90.0, 7)):
            y = MIDDLE[1] + cy * (HALF[0] - CORNER_M) + CORNER_M * math.cos(angle)
            z = MIDDLE[2] + cz * (HALF[1] - CORNER_M) + CORNER_M * math.sin(angle)
            points.append(PathPoint(at_m=(MIDDLE[0], y, z), rpy_deg=DOWN))
        ahead = {90: (-1, 0), 180: (0, -1), 270: (1, 0), 360: (0, 1)}[begin + 90]
        straight = 2.0 * (HALF[0] if ahead[0] else HALF[1]) - 2.0 * CORNER_M
        count = max(round(straight / 0.25), 2)
        last = points[-1].at_m
        for k in range(1, count):
            way = straight * k / count
            at = (last[0], last[1] + ahead[0] * way, last[2] + ahead[1] * way)
            points.append(PathPoint(at_m=at, rpy_deg=DOWN))
    points.append(points[0])
    return FollowPath(do="follow", points=tuple(points), kind="spline", speed_m_s=SPEED_M_S, deviation_m=0.0)


def path_of(machine: str) -> tuple[FollowPath, dict[str, float]]:
    """Return a machine's path, and the posture it begins in [rad]."""
    if machine == "brokk5":
        loaded = load_scenario(PLACE)
        assert loaded.posture is not None
        step = next(one for one in loaded.scenario.drive if isinstance(one, FollowPath))
        return step.model_copy(update={"speed_m_s": SPEED_M_S}), dict(loaded.posture)
    return rectangle(), {name: math.radians(value) for name, value in START_DEG.items()}


def settings_of(machine: MachineModel, feed_forward: bool, compensate: bool) -> FollowSettings:
    """Return how jobs are followed, the gain one that late joints bear without being made up for."""
    if compensate:
        return FollowSettings(feed_forward=feed_forward)
    model = StoppingModel.of(machine)
    late_s = float((model.dead_time_s + model.lag_s).max())
    plain = FollowSettings(feed_forward=feed_forward, compensate=False)
    return replace(plain, gain_1_s=min(plain.gain_1_s, STEADY / late_s))


def driven(name: str, joints: Joints, follow: FollowSettings | None) -> dict[str, Any]:
    """Return errors and times of one drive along a machine's path."""
    machine = load_machine(name)
    path, posture = path_of(name)
    place = load_scenario(PLACE)
    session = Session(
        machine=machine,
        rules=place.rules,
        guard="none",
        at=place.place if name == "brokk5" else ELSEWHERE,
        posture=posture,
        tick_s=TICK_S,
        joints=joints,
        follow=follow,
    )
    steps: Sequence[Step] = (Hold(do="hold", for_s=0.3), path)
    series = run_session(session, steps, "tracking").automatic
    assert series is not None
    last = series.jobs[-1]
    return {
        "completed": series.completed,
        "rms_error_m": round(last.rms_error_m, 6),
        "max_error_m": round(last.max_error_m, 6),
        "max_error_deg": round(math.degrees(last.max_error_rad), 5),
        "planned_s": round(last.planned_s, 3),
        "driven_s": round(last.ended_s - last.begun_s, 3),
    }


def rows(machine: str, kinds: Sequence[str], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Return a machine's rows."""
    found = []

    def add(
        words: str, joints: Joints, forward: bool, made_up: bool, seed: int | None, given: FollowSettings | None
    ) -> None:
        facts = {"machine": machine, "joints": words, "feed_forward": forward, "compensate": made_up, "seed": seed}
        found.append({**facts, **driven(machine, joints, given)})

    model = load_machine(machine)
    if "ideal" in kinds:
        add("ideal", "ideal", True, False, None, None)
    if "hydraulic" in kinds:
        for forward in (True, False):
            for made_up in (True, False):
                add("hydraulic", "hydraulic", forward, made_up, None, settings_of(model, forward, made_up))
    if "drawn" in kinds:
        for seed in seeds:
            add("drawn", HydraulicChoice(vary_seed=seed), True, True, seed, None)
    return found


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", choices=("rre20", "brokk5"), action="append", help="only this one")
    parser.add_argument("--joints", choices=("ideal", "hydraulic", "drawn"), action="append", help="only these")
    parser.add_argument("--seeds", type=int, default=5, help="how many machines are drawn")
    parser.add_argument("--json", action="store_true", help="the object instead of words")
    given = parser.parse_args()
    kinds = given.joints or ("ideal", "hydraulic", "drawn")
    found = [one for name in given.machine or ("rre20", "brokk5") for one in rows(name, kinds, range(given.seeds))]
    if given.json:
        print(json.dumps({"rows": found}))
        return
    for row in found:
        print("  ".join(f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()
