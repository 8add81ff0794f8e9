"""The page's section on chatter: what it says of a smooth run and of a trembling one, and where it says nothing."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from workgauge.rehearse.result import RunResult
from workgauge.report.chatter_figures import acceleration_figure, chatter_section, spectrum_figure
from workgauge.report.page import render


def trembling(run: RunResult, joint: int = 4, hz: float = 8.0) -> RunResult:
    """The run with one joint trembling, 0.05 rad/s to both sides."""
    sent = run.series.sent.copy()
    sent[:, joint] += 0.05 * np.sin(2 * np.pi * hz * run.series.t_s)
    return replace(run, series=replace(run.series, sent=sent))


def test_a_smooth_run_is_called_smooth(run: RunResult) -> None:
    smooth = replace(run, series=replace(run.series, sent=run.series.wanted))
    assert "nothing of it is faster than 2 Hz" in chatter_section(smooth)


def test_a_trembling_joint_is_named_with_its_number(run: RunResult) -> None:
    text = chatter_section(trembling(run))
    told = re.search(r"most of it of the tilt \(([\d.]+) °/s²\)", text)
    assert told is not None
    # an amplitude of 0.05 rad/s times 2 pi 8 Hz, as a root mean square; differences of 10 ms show 1 % less
    assert float(told.group(1)) == pytest.approx(math.degrees(0.05 * 16 * math.pi) / math.sqrt(2), rel=0.015)
    assert "2 Hz" in render(trembling(run))


def test_a_sliding_joint_is_told_in_millimetres(run: RunResult) -> None:
    sliding = replace(trembling(run), prismatic=(False, False, False, False, True, False))
    assert "mm/s²" in chatter_section(sliding)
    assert "°/s², mm/s²" in acceleration_figure(sliding)


def test_ticks_too_slow_to_show_it_leave_the_section_out(run: RunResult) -> None:
    slow = replace(run, tick_s=0.25)
    assert chatter_section(slow) == ""
    assert slow.as_json()["chatter"] is None
    assert "Smoothness" not in render(slow)


def test_short_peaks_are_cut_off_and_it_says_so(run: RunResult) -> None:
    sent = np.zeros_like(run.series.sent)
    sent[300:, 0] = 0.5
    assert "short peaks are cut off" in acceleration_figure(replace(run, series=replace(run.series, sent=sent)))
    assert "cut off" not in acceleration_figure(replace(run, series=replace(run.series, sent=0.0 * sent)))


def test_the_spectrum_peaks_at_the_tremor(run: RunResult) -> None:
    picture = spectrum_figure(trembling(run, hz=12.0))
    points = picture.split('class="line s0" points="')[1].split('"')[0].split()
    column, _ = min((tuple(map(float, point.split(","))) for point in points), key=lambda point: point[1])
    left, right = 64.0, 860.0 - 128.0
    assert abs((column - left) / (right - left) * 50.0 - 12.0) < 0.6


def test_a_machine_that_never_moved_has_a_page(run: RunResult) -> None:
    still = replace(run, series=replace(run.series, sent=0.0 * run.series.sent, wanted=0.0 * run.series.wanted))
    assert "nan" not in chatter_section(still)
    assert still.as_json()["chatter"]["total"] == 0.0
