"""A run made up by hand: a box arm that drives at a pole, is held, and goes back."""

from pathlib import Path

import numpy as np
import pytest

from workgauge.rehearse.result import Entry, Intervention, RunResult, Series, Snapshot, TickTimes
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box, PrismChain, Surface, Tube
from workgauge.values.transforms import translation

T_S = 0.01


def approach(n: int = 900) -> tuple[Floats, Floats]:
    """Return times and a clearance that starts at 2 m, closes at 1 m/s scaled by eq. 3.12, and opens again."""
    t = np.arange(n) * T_S
    gap, out = 2.0, []
    for now in t:
        out.append(gap)
        scale = np.clip((gap - 0.2) / 0.6, 0.0, 1.0)
        gap += T_S * (0.0 if now < 1 else -scale if now < 5.5 else 1.0 if gap < 2.0 else 0.0)
    return t, np.array(out)


def limits() -> tuple[Limit, ...]:
    """Return one limit of every drawable solid."""

    def limit(name: str, kind: LimitKind, solid: object) -> Limit:
        return Limit(f"{kind}:{name}", kind, name, solid, "by hand", Source("site.xml", name))  # type: ignore[arg-type]

    n = 12
    x = np.linspace(-30.0, 30.0, n + 1)
    axis = np.stack([x, 6.0 + 0.002 * x**2, np.zeros(n + 1)], axis=1)
    section = np.array([[-1.8, 0.0], [1.8, 0.0], [1.8, 3.6], [-1.8, 3.6]])
    chain = PrismChain(
        axis[:-1],
        axis[1:],
        np.tile([0.0, 1.0, 0.0], (n, 1)),
        np.tile(section, (n, 1, 1)),
        np.stack([x[:-1], x[1:]], axis=1) + 30.0,
        np.ones((n, 2), dtype=np.bool_),
    )
    grid = np.array([[a, b, -0.3 + 0.02 * a] for a in range(-20, 21, 4) for b in range(-20, 21, 4)], dtype=np.float64)
    faces = [
        face
        for i in range(10)
        for j in range(10)
        for k in (11 * i + j,)
        for face in ((k, k + 11, k + 12), (k, k + 12, k + 1))
    ]
    return (
        limit("Pole 12", LimitKind.POINT, Box(translation(9.0, -1.0, 4.0), frozen([0.2, 0.2, 4.0]))),
        limit("Track 2", LimitKind.TRACK, chain),
        limit("Contact wire", LimitKind.OVERHEAD_LINE, Tube(frozen([[-30, 0, 7], [30, 0, 7]]), 1.0)),
        limit("Ground", LimitKind.SURFACE, Surface(frozen(grid), frozen_ints(faces))),
    )


def snapshot(t_s: float, reach: float) -> Snapshot:
    """Return a machine of three boxes whose tool stands at x = reach."""
    boxes = [translation(0, 0, 0.6), translation(0, 0, 1.8), translation(reach / 2, -0.5, 1.6)]
    halves = [[1.9, 1.3, 0.6], [1.6, 1.3, 0.6], [reach / 2, 0.3, 0.3]]
    return Snapshot(
        t_s,
        np.stack(boxes),
        np.array(halves),
        ("undercarriage", "cab", "arm"),
        np.array([reach, -0.5, 1.6]),
        np.array([reach, -0.8, 1.6]),
        np.array([8.8, -0.8, 1.6]),
        8.8 - reach,
        "point:Pole 12",
    )


@pytest.fixture
def run() -> RunResult:
    """Return a finished run that was stopped by Pole 12."""
    t, gap = approach()
    reach = 8.8 - gap
    wanted = np.where((t >= 1) & (t < 5.5), 1.0, np.where((t >= 5.5) & (gap < 2.0), -1.0, 0.0))
    scale = np.where(wanted > 0, np.clip((gap - 0.2) / 0.6, 0, 1), 1.0)
    ratio = np.array([0.0, 0.35, -0.5, 0.2, 0.0, 0.0])
    asked = wanted[:, None] * ratio * (1 + 0.1 * np.sin(t))[:, None]
    series = Series(
        t_s=t,
        q=np.cumsum(asked * scale[:, None], axis=0) * T_S,
        wanted=asked,
        allowed=asked * scale[:, None],
        valves=np.round(asked * scale[:, None] * 1e4),
        sent=asked * scale[:, None],
        scale=scale,
        true_m=gap,
        believed_m=gap,
        self_m=np.full(len(t), 0.7),
        tool=np.stack([reach, np.full(len(t), -0.5), np.full(len(t), 1.6)], axis=1),
        step=np.zeros(len(t)),
        by_limit={"point:Pole 12": gap, "surface:Ground": np.where(t > 2, 1.3 + 0.1 * np.sin(t), np.nan)},
    )
    nearest = int(np.argmin(gap))
    return RunResult(
        title="A pole by hand",
        description="Made up for the tests of the page.",
        facts={"machine": "three boxes", "guard": "linear"},
        joint_names=("swing", "boom", "stick", "bucket", "tilt", "rotate"),
        prismatic=(False,) * 6,
        tick_s=T_S,
        substeps=2,
        slow_distance_m=0.8,
        stop_distance_m=0.2,
        series=series,
        steps=(("hold", 0.0), ("to the pole", 1.0), ("back", 5.5)),
        min_clearance_m=float(gap.min()),
        min_limit="point:Pole 12",
        min_link="arm",
        min_self_clearance_m=0.7,
        min_self_pair=("arm", "undercarriage"),
        entries=(),
        self_entries=(),
        interventions=(
            Intervention(
                2.2, 5.5, "limit_near", "arm", "point:Pole 12", None, float(gap.min()), 0.003, "near Pole 12"
            ),
        ),
        tick_ms=TickTimes(0.41, 0.55, 1.9),
        start=snapshot(0.0, float(reach[0])),
        nearest=snapshot(float(t[nearest]), float(reach[nearest])),
        end=snapshot(float(t[-1]), float(reach[-1])),
        limits=limits(),
        limit_names={"point:Pole 12": "Pole 12", "track:Track 2": "Track 2"},
        assumptions=("Joints follow their command exactly.", "Sensors are perfect."),
        warnings=("the alignment <Track 2> has no profile",),
    )


@pytest.fixture
def entry() -> Entry:
    """Return one entry of the arm into Pole 12."""
    return Entry("point:Pole 12", "arm", 4.0, 4.5, 0.031)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder that does not exist yet."""
    return tmp_path / "deep" / "report"
