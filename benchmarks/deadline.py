"""How often a 500 Hz loop misses its deadline: whole barrier ticks beside a loop that only sleeps; JSON by `--json`.

Every 2 ms of the monotonic clock begins a period. The loop sleeps until then, does its work, and has missed the
deadline if the work is not done when the next period begins; it goes on with the first period still to come. In the
one loop the work is a whole tick with the barrier guard: 0.3 s of dead time, 0.2 s of lag, 0.6 s from full speed to
rest, each known to 20 %, among 10,000 limits, on a recorded drive (see `tick.py`). In the other there is none: what
it misses, computer and operating system miss. The two take turns in blocks of a second, so that both see the same
computer.

As in a control loop, everything made before the first period is kept from the garbage collector (`gc.freeze`) and the
collector is off in the loop: nothing a tick makes refers to itself, so all of it goes when nobody needs it any more.

- `periods`: of each loop. `ticks_missed`, `bare_missed`: share of periods whose deadline was missed.
- `more_missed`: the difference. `limit`: what it may be, 0.002. `passed`: whether it is not more.
- `tick_ms`: median and 99.9th percentile of the ticks' own time.
"""

import argparse
import gc
import json
import statistics
import time
from collections.abc import Callable

import numpy as np
from tick import job, pole_limits, poles, workgauge_step

PERIOD_NS = 2_000_000
BLOCK = 500
LIMIT = 0.002
LIMITS = 10_000


def block(work: Callable[[int], object] | None, first: int, times_ns: list[int]) -> int:
    """Run a block of periods and return how many deadlines were missed."""
    missed, begins = 0, time.perf_counter_ns() + PERIOD_NS
    for k in range(BLOCK):
        time.sleep(max(begins - time.perf_counter_ns(), 0) * 1e-9)
        before = time.perf_counter_ns()
        if work is not None:
            work(first + k)
        after = time.perf_counter_ns()
        times_ns.append(after - before)
        if after > begins + PERIOD_NS:
            missed += 1
            begins += (after - begins) // PERIOD_NS * PERIOD_NS
        begins += PERIOD_NS
    return missed


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a line")
    parser.add_argument("--blocks", type=int, default=40, help="of each loop, a second long")
    asked = parser.parse_args()
    step = workgauge_step(job(), pole_limits(poles(LIMITS)), guard="barrier", late=True, dt_s=PERIOD_NS * 1e-9)
    block(step, 0, [])
    gc.collect()
    gc.freeze()
    gc.disable()
    ticks, bare, times_ns = 0, 0, list[int]()
    for k in range(asked.blocks):
        bare += block(None, 0, [])
        ticks += block(step, (k + 1) * BLOCK, times_ns)
    periods = asked.blocks * BLOCK
    more = (ticks - bare) / periods
    answer = {
        "periods": periods,
        "ticks_missed": ticks / periods,
        "bare_missed": bare / periods,
        "more_missed": more,
        "limit": LIMIT,
        "passed": more <= LIMIT,
        "tick_ms": [1e-6 * statistics.median(times_ns), 1e-6 * float(np.percentile(times_ns, 99.9))],
    }
    if asked.json:
        print(json.dumps(answer))
    else:
        print(f"missed: {answer['ticks_missed']:.3%} with ticks, {answer['bare_missed']:.3%} without")


if __name__ == "__main__":
    main()
