"""The map of what was dug: every cell is drawn once in its colour, and what is said of it is what it shows."""

import re

import numpy as np
import pytest

from workgauge.motion.bucket.dug import DugMap
from workgauge.report.dug_section import COLOURS, colour_range, dug_figure, dug_section


def made(left, allowed=0.02, deepest=0.012) -> DugMap:
    return DugMap(np.array([1000.0, 2000.0]), 0.05, np.asarray(left, dtype=float), deepest, allowed)


def test_nothing_dug_is_no_section() -> None:
    assert dug_section(None) == ""


def test_bars_cover_the_cells_that_were_swept() -> None:
    rng = np.random.default_rng(4)
    left = np.where(rng.random((30, 20)) < 0.3, np.nan, rng.normal(0.0, 0.01, (30, 20)))
    figure = dug_figure(made(left))
    bars = re.findall(r'<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)" fill="(#\w+)"/>', figure)
    bars = [bar for bar in bars if float(bar[2]) < 20 or float(bar[3]) < 30][: -len(COLOURS)]
    scale = float(bars[0][2]) - 0.05
    cells = sum(round((float(high) - 0.05) / scale) for _, _, _, high, _ in bars)
    assert cells == np.isfinite(left).sum()
    assert {fill for *_, fill in bars} <= set(COLOURS)


@pytest.mark.parametrize(("value", "colour"), [(-0.05, COLOURS[0]), (0.0, COLOURS[4]), (0.05, COLOURS[-1])])
def test_below_is_red_and_above_is_blue(value: float, colour: str) -> None:
    left = np.full((4, 4), value)
    left[0, 0] = 0.05
    dug = made(left)
    assert colour_range(dug) == pytest.approx(0.05)
    assert f'fill="{colour}"' in dug_figure(dug)


def test_what_is_said() -> None:
    fine = dug_section(made(np.full((3, 3), 0.004)))
    assert "RMS\n4.0 mm" in fine and "Nowhere deeper than the 20 mm" in fine
    deep = dug_section(made(np.full((3, 3), -0.03), deepest=0.03))
    assert "<strong>Deeper than the 20 mm allowed.</strong>" in deep
    assert "allowed" not in dug_section(made(np.full((3, 3), 0.0), allowed=None))
