"""Long proofs, one table: millions of ticks against geometric truth, big fuzzing, and the tests marked `prove`.

    make prove                      everything, about an hour on two cores
    python benchmarks/prove.py --scale 0.05 --json

Every row says what must never happen, how often it was tried, how often it happened, and the worst value seen. The
exit code is 1 if any row failed.
"""

import argparse
import json
import multiprocessing
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from workgauge.gauge.build import build_limits
from workgauge.gauge.own_track import without_own_track
from workgauge.gauge.rulebook import load_rule_book
from workgauge.guard.registry import guard_named
from workgauge.loop.config import tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene
from workgauge.rehearse.posture import start_posture
from workgauge.rehearse.scenario import OnTrack
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.rehearse.start import stand
from workgauge.sim.kinematic import KinematicPlant
from workgauge.site.read import read_site
from workgauge.values.errors import InputError, WireError
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp
from workgauge.wire.messages import decode, encode

ROOT = Path(__file__).parents[1]
TICK_S = 0.01
DRIVE_TICKS = 1_000
TRUTH_RADIUS_M = 0.5


@dataclass(frozen=True, slots=True)
class Row:
    """One proof: what never happens, tries, failures, the worst value and its meaning, seconds."""

    never: str
    tried: int
    happened: int
    worst: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Drives:
    """What a batch of random drives came to; `worst_m` is the least of true clearance less stop distance."""

    ticks: int
    entries: int
    worst_m: float
    scaled: int


def random_drives(arguments: tuple[int, int]) -> Drives:
    """Drive the excavator on the shipped site with random full levers, every drive from a random clear posture.

    Args:
        arguments: seed, number of ticks.
    """
    seed, ticks = arguments
    rng = np.random.default_rng(seed)
    machine = load_machine("rre20")
    site = read_site(shipped_site_files("double_track"))
    rules = load_rule_book("finland")
    guard = guard_named("linear")
    config = tick_config(machine, guard, machine_id=machine.name, dt_s=TICK_S, radius_m=guard.reach_m)
    done = entries = scaled = 0
    worst = np.inf
    while done < ticks:
        place = OnTrack(alignment="Track 1", distance_m=float(rng.uniform(20, 1180)))
        standing = stand(site, rules, machine, place)
        position = standing.T_absolute_machine[:3, 3]
        frame = site.frame((float(position[0]), float(position[1]), float(position[2])))
        T = np.array(standing.T_absolute_machine)
        T[:3, 3] = frame.to_local(position)
        scene = Scene(machine, without_own_track(build_limits(site, rules, frame), standing.own_track))
        for _ in range(20):
            q = _clear_posture(rng, machine, scene, T)
            counted, inside, nearest, slowed = _one_drive(rng, machine, scene, T, q, config)
            done, entries, scaled = done + counted, entries + inside, scaled + slowed
            worst = min(worst, nearest)
            if done >= ticks:
                break
    return Drives(done, entries, float(worst), scaled)


def _clear_posture(rng, machine, scene, T):
    """Return a posture clear of everything, somewhere between one that is and a random one."""
    clear = start_posture(scene, T, None)
    for _ in range(200):
        q = clear + rng.random() * (rng.uniform(machine.sample_min, machine.sample_max) - clear)
        found = scene.query(machine.forward(q), T, TRUTH_RADIUS_M)
        if not len(found) or found.distances.min() > 0.25:
            return q
    return clear


def _one_drive(rng, machine, scene, T, q, config):
    nearest, inside, entries, slowed = np.inf, False, 0, 0

    def check(_now, q_true, T_true):
        nonlocal nearest, inside, entries
        found = scene.query(machine.forward(q_true), T_true, TRUTH_RADIUS_M)
        least = float(found.distances.min(initial=np.inf))
        stops = np.where(np.isnan(found.stop_distances), config.guard.stop_distance_m, found.stop_distances)
        nearest = min(nearest, float((found.distances - stops).min(initial=np.inf)))
        entries += least < 0.0 and not inside
        inside = least < 0.0

    plant = KinematicPlant(
        machine, machine_id=machine.name, q=q, T_site_machine=T, substep_s=TICK_S, on_substep=check
    )
    memory, posture, pose = first_memory(config), None, None
    levers, mode = Levers(), DriveMode.JOINT
    for k in range(DRIVE_TICKS):
        now = plant.now_ns
        for chunk in plant.read():
            value = decode(chunk.data, now).value
            posture = value if isinstance(value, Posture) else posture
            pose = value if isinstance(value, MachinePose) else pose
        if k > 2 and k % 50 == 3:
            mode = DriveMode.JOINT if rng.random() < 0.7 else DriveMode.TOOL
            levers = Levers(*np.where(rng.random(6) < 0.5, rng.choice([-1.0, 1.0], 6), rng.uniform(-1, 1, 6)))
        intent = Intent(Stamp(machine.name, now, "operator"), mode, levers if k > 2 else Levers(), k > 0)
        outputs, memory, trace = tick(TickInputs(now, posture, pose, intent, scene), memory, config)
        slowed += trace.scale < 1.0
        plant.write(outputs.frame)
        plant.advance(TICK_S)
    return DRIVE_TICKS, entries, nearest, slowed


def prove_drives(scale: float, pool) -> Row:
    """Two million ticks of random driving: no link ever enters a limit or another link."""
    began = time.perf_counter()
    ticks = int(1_000_000 * scale)
    results = pool.map(random_drives, [(seed, ticks) for seed in (1, 2)])
    worst = min(result.worst_m for result in results)
    slowed = sum(result.scaled for result in results)
    return Row(
        "a link enters a limit or another link (linear guard, ideal joints)",
        sum(result.ticks for result in results),
        sum(result.entries for result in results),
        f"{1000 * worst:+.1f} mm beyond the stop distance; slowed in {slowed:,} ticks",
        time.perf_counter() - began,
    )


def fuzz_frames(arguments: tuple[int, int]) -> tuple[int, int]:
    """Mutate valve frames; return tries and how often a changed frame was read as a command all the same."""
    seed, tries = arguments
    rng = random.Random(seed)
    stamp = Stamp("rre20", 1, "fuzz", 1)
    original = encode(Posture.exact(stamp, np.linspace(-1, 1, 6)), 7)
    accepted = 0
    for _ in range(tries):
        frame = bytearray(original)
        for _ in range(rng.randint(1, 6)):
            kind = rng.randrange(3)
            place = rng.randrange(len(frame))
            if kind == 0:
                frame[place] ^= 1 << rng.randrange(8)
            elif kind == 1:
                del frame[place]
            else:
                frame.insert(place, rng.randrange(256))
        if bytes(frame) == original:
            continue
        try:
            decode(bytes(frame), 2)
        except WireError:
            continue
        accepted += 1
    return tries, accepted


def prove_frames(scale: float, pool) -> Row:
    """Mutated frames are refused as such, and nothing but `WireError` is raised."""
    began = time.perf_counter()
    results = pool.map(fuzz_frames, [(seed, int(500_000 * scale)) for seed in (1, 2)])
    return Row(
        "a mutated frame is read as a message, or anything but WireError is raised",
        sum(tries for tries, _ in results),
        sum(accepted for _, accepted in results),
        "",
        time.perf_counter() - began,
    )


def fuzz_files(arguments: tuple[int, int]) -> tuple[int, int, int]:
    """Mutate the shipped track file; return tries, files read all the same, and exceptions of another family."""
    seed, tries = arguments
    rng = random.Random(seed)
    originals = [file.read_bytes() for file in shipped_site_files("double_track") if file.stat().st_size < 100_000]
    read = other = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutated.xml"
        for _ in range(tries):
            data = bytearray(rng.choice(originals))
            for _ in range(rng.randint(1, 8)):
                place = rng.randrange(len(data))
                kind = rng.randrange(4)
                if kind == 0:
                    data[place] = rng.randrange(256)
                elif kind == 1:
                    del data[place : place + rng.randint(1, 40)]
                elif kind == 2:
                    data[place:place] = bytes(data[place : place + rng.randint(1, 40)])
                else:
                    data[place:place] = rng.choice([b"NaN", b"-", b"1e308", b"INF", b"0", b"<", b"\x00"])
            path.write_bytes(data)
            try:
                read_site([path])
                read += 1
            except InputError:
                pass
            except Exception as error:
                other += 1
                kept = Path(tempfile.gettempdir()) / f"workgauge-fuzz-{seed}-{other}.xml"
                kept.write_bytes(data)
                print(f"{type(error).__name__}: {error} (kept as {kept})", file=sys.stderr)
    return tries, read, other


def prove_files(scale: float, pool) -> Row:
    """Mutated site files are read or refused with a message, never anything else."""
    began = time.perf_counter()
    results = pool.map(fuzz_files, [(seed, int(10_000 * scale)) for seed in (1, 2)])
    return Row(
        "a mutated site file raises anything but an input error",
        sum(tries for tries, _, _ in results),
        sum(other for _, _, other in results),
        f"{sum(read for _, read, _ in results)} were still readable",
        time.perf_counter() - began,
    )


def prove_tests(_scale: float, _pool) -> Row:
    """The long property tests that `make test` leaves out; those of the whole cockpit by themselves."""
    began = time.perf_counter()
    passed = failed = 0
    runs = [("prove and not stack", "2", "tests")]
    # every file with a stack of its own by itself: two at once starve each other
    runs += [("prove and stack", "0", str(file)) for file in sorted((ROOT / "tests" / "cockpit").glob("test_*.py"))]
    for which, jobs, where in runs:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", where, "-m", which, "-n", jobs, "-p", "no:cacheprovider"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        last = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else done.stderr.strip()[-200:]
        words = last.replace(",", "").split()
        passed += int(words[words.index("passed") - 1]) if "passed" in words else 0
        broken = done.returncode not in (0, 5)  # 5: this file has none
        wrong = int(words[words.index("failed") - 1]) if "failed" in words else int(broken)
        if wrong:
            print(done.stdout, file=sys.stderr)
        failed += wrong
    return Row(
        "a long property test fails (pytest -m prove)", passed + failed, failed, "", time.perf_counter() - began
    )


PROOFS: tuple[Callable[..., Row], ...] = (prove_drives, prove_frames, prove_files, prove_tests)


def main() -> int:
    """Run the proofs and print one table, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="how many tries, as a share of the full number")
    parser.add_argument("--json", action="store_true", help="one object on standard output")
    options = parser.parse_args()
    console = Console(stderr=options.json)
    rows = []
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for proof in PROOFS:
            with console.status(proof.__doc__ or proof.__name__):
                row = proof(options.scale, pool)
            console.print(f"{row.never}: {row.happened} of {row.tried:,}; {row.worst} ({row.seconds:.0f} s)")
            rows.append(row)
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows]}))
    else:
        table = Table("never", "tried", "happened", "worst seen", "seconds", title="Long proofs")
        for row in rows:
            colour = "red" if row.happened or not row.tried else "green"
            table.add_row(
                row.never, f"{row.tried:,}", f"[{colour}]{row.happened}[/]", row.worst, f"{row.seconds:.0f}"
            )
        console.print(table)
    return int(any(row.happened or not row.tried for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
