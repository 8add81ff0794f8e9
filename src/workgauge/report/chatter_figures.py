"""Chatter drawn: the commanded joint acceleration over time, and its spectrum with the line at 2 Hz."""

from html import escape

import numpy as np

from workgauge.rehearse.chatter import ABOVE_HZ, Chatter, accelerations, spectrum
from workgauge.rehearse.result import RunResult
from workgauge.report.axes import Chart
from workgauge.values.arrays import Floats

#: The spectrum is drawn this far below its peak [dB].
DEPTH_DB = 50.0
#: The scale over time reaches so many times as far as all but 1 % of the accelerations.
HEADROOM = 1.6


def chatter_section(result: RunResult) -> str:
    """Return the page's section on chatter, or nothing for a run whose ticks are too slow to show any."""
    found = result.chatter()
    if found is None or result.ticks < 2:
        return ""
    return f"""<section>
<h2>Smoothness</h2>
<p>Acceleration of the joint velocities that were commanded. {escape(_words(found, result))} The spectrum tells a
guard that trembles (a hump or a plateau beyond 2 Hz, above the levers' own) from one that holds still.</p>
{acceleration_figure(result)}
{spectrum_figure(result)}
</section>"""


def _words(found: Chatter, result: RunResult) -> str:
    """Return the numbers in a sentence."""
    by_joint = _for_people(found.by_joint[None, :], result)[0]
    worst = int(np.argmax(by_joint))
    unit = "mm/s²" if result.prismatic[worst] else "°/s²"
    if by_joint[worst] < 0.05:
        return f"Beyond what the levers themselves did, nothing of it is faster than {ABOVE_HZ:g} Hz."
    return (
        f"Beyond what the levers themselves did, {np.degrees(found.total):.1f} °/s² (root mean square) of it is"
        f" faster than {ABOVE_HZ:g} Hz, most of it of the {result.joint_names[worst]} ({by_joint[worst]:.1f} {unit})."
    )


def _for_people(values: Floats, result: RunResult) -> Floats:
    """Return joint values (k, n) in degrees, or millimetres for sliding joints."""
    return np.asarray(values * np.where(np.asarray(result.prismatic), 1000.0, np.degrees(1.0)))


def acceleration_figure(result: RunResult) -> str:
    """Return every joint's commanded acceleration over time; peaks beyond the scale are cut off, and it says so."""
    series = result.series
    a = _for_people(accelerations(series.sent, result.tick_s), result)
    size = np.abs(a)
    reach = max(HEADROOM * float(np.percentile(size.max(axis=1), 99.0)), 5.0)
    cut = bool((size > reach).any())
    unit = "°/s², mm/s²" if any(result.prismatic) else "°/s²"
    chart = Chart(
        "Commanded joint acceleration over time",
        "time [s]" + (" (short peaks are cut off)" if cut else ""),
        f"acceleration [{unit}]",
        (0.0, max(result.simulated_s, result.tick_s)),
        (-reach, reach),
    )
    chart.marks(result.steps)
    for j, name in enumerate(result.joint_names):
        chart.line(series.t_s, np.clip(a[:, j], -reach, reach), f"s{j % 8} fine", name, tag=bool(size[:, j].any()))
    return chart.svg()


def spectrum_figure(result: RunResult) -> str:
    """Return the power density of the commanded and of the wanted acceleration, all joints together, in dB."""
    f, sent = spectrum(result.series.sent, result.tick_s)
    _, wanted = spectrum(result.series.wanted, result.tick_s)
    sums = [_for_people(np.sqrt(one), result) ** 2 for one in (sent, wanted)]
    curves = [10.0 * np.log10(np.maximum(one.sum(axis=1), 1e-12)) for one in sums]
    top = 10.0 * np.ceil((max(float(curve.max()) for curve in curves) + 5.0) / 10.0)
    low = top - DEPTH_DB
    chart = Chart(
        "Spectrum of the commanded joint acceleration, all joints",
        "frequency [Hz]",
        "density [dB of (°/s²)²/Hz]",
        (0.0, float(f[-1])),
        (low, top),
    )
    chart.span(ABOVE_HZ, float(f[-1]), "cause", f"faster than {ABOVE_HZ:g} Hz counts as chatter")
    chart.marks([(f"{ABOVE_HZ:g} Hz and faster: chatter, where above the levers", ABOVE_HZ)])
    for curve, css, name in zip(curves, ("s0", "s7 wanted"), ("commanded", "levers"), strict=True):
        chart.line(f, np.where(curve >= low, curve, np.nan), css, name)
    return chart.svg()
