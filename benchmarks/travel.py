"""Does a tick cost more while the undercarriage travels? One machine standing, one travelling, tick by tick in turn.

    python benchmarks/travel.py --json

Prints `{"ticks", "travelled_m", "standing_ms", "travelling_ms", "ratio"}`; times are `{"p50", "p90"}` of the tick
alone, on simulated receivers, beside the open track of the shipped site. Taking turns, both see the same load.
"""

import argparse
import json

import numpy as np

from workgauge import Session
from workgauge.rehearse.scenario import OnTrack
from workgauge.rehearse.sensing import SensorChoice

PLACE = OnTrack(alignment="Track 1", distance_m=450.0)
#: The arm points at the other track, outside every stop distance.
POSTURE = {"swing": 0.122, "boom": 0.279, "stick": -0.698, "bucket": -2.007}
SPEED_M_S = 3.0
TICK_S = 0.02
#: Until positions are fixed, the levers armed and the speed reached.
WARM_UP = 250


def session() -> Session:
    """Return the machine at its place, sensors on."""
    return Session(at=PLACE, posture=POSTURE, sensors=SensorChoice(seed=7), tick_s=TICK_S)


def measure(ticks: int) -> dict[str, object]:
    """Return the times of `ticks` ticks of each, after the warm-up."""
    standing, travelling = session(), session()
    times: tuple[list[float], list[float]] = ([], [])
    for k in range(WARM_UP + ticks):
        for one, speed, kept in zip((standing, travelling), (0.0, SPEED_M_S), times, strict=True):
            one.travel(speed if k > 60 else 0.0)
            done = one.step(one.intent(enable=one.ready and k > 40))
            if k >= WARM_UP:
                kept.append(done.tick_ms)
    rows = [{f"p{p}": round(float(np.percentile(one, p)), 4) for p in (50, 90)} for one in times]
    return {
        "ticks": ticks,
        "travelled_m": round(travelling.true_travel[1], 2),
        "standing_ms": rows[0],
        "travelling_ms": rows[1],
        "ratio": round(rows[1]["p50"] / rows[0]["p50"], 3),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=1000, help="measured ticks of each")
    parser.add_argument("--json", action="store_true", help="the object instead of words")
    given = parser.parse_args()
    found = measure(max(given.ticks, 1))
    if given.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:14} {value}")


if __name__ == "__main__":
    main()
