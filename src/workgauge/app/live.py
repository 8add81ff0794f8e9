"""What a person at a terminal sees while a run goes on: clearance, what it is to, scale, joint speeds."""

import math
import time
from collections.abc import Callable
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table
from rich.text import Text

from workgauge.machine.model import MachineModel
from workgauge.rehearse.run import Progress

#: The picture changes at most this often [s].
FRAME_S = 1 / 20

BAR = 40


def bar(share: float, width: int = BAR) -> str:
    """Return a bar filled from the left by `share`, 0 to 1."""
    full = round(max(0.0, min(1.0, share)) * width)
    return "█" * full + "░" * (width - full)


def centred_bar(share: float, width: int = BAR) -> str:
    """Return a bar filled from its middle to the left (negative) or right by `share`, -1 to 1."""
    half = width // 2
    full = round(min(1.0, abs(share)) * half)
    left = "░" * (half - full) + "█" * full if share < 0 else "░" * half
    right = "█" * full + "░" * (half - full) if share > 0 else "░" * half
    return left + "│" + right


class LiveView:
    """Shows a run as it goes, at `speed` times real time (0: as fast as it computes). Use as a context."""

    def __init__(self, console: Console, machine: MachineModel, slow_distance_m: float | None, speed: float) -> None:
        self._machine = machine
        self._slow = slow_distance_m or 1.0
        self._speed = speed
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._began: float | None = None
        self._shown = -math.inf

    def __enter__(self) -> "LiveView":
        self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.__exit__(kind, error, trace)

    def show(self, progress: Progress) -> None:
        """Take in one tick; wait if the run is ahead of the clock, draw if it is time to."""
        now = time.monotonic()
        if self._began is None:
            self._began = now
        if self._speed > 0:
            ahead = self._began + progress.t_s / self._speed - now
            if ahead > FRAME_S:
                self._draw(progress)
                time.sleep(ahead)
                return
        if now - self._shown >= FRAME_S:
            self._draw(progress)

    def _draw(self, progress: Progress) -> None:
        self._live.update(self.picture(progress), refresh=True)
        self._shown = time.monotonic()

    def picture(self, progress: Progress) -> Panel:
        """Return the panel for one moment."""
        trace = progress.result.trace
        near = progress.clearance_m
        colour = "green" if near is None or near > self._slow else "yellow" if trace.scale > 0.05 else "red"
        rows = _grid()
        share = 0.0 if near is None else near / (3 * self._slow)
        shown = Text("none in sight" if near is None else f"{near:.3f} m", style=f"bold {colour}")
        rows.add_row("clearance", Text(bar(share), style=colour), shown)
        rows.add_row("speed left", Text(bar(trace.scale), style=colour), Text(f"{100 * trace.scale:.0f} %"))
        joints = _grid()
        for j, name in enumerate(self._machine.joint_names):
            rate = float(trace.allowed[j]) + 0.0
            most = float(max(self._machine.speed_positive[j], self._machine.speed_negative[j]))
            speed = f"{rate * 1000:+.0f} mm/s" if self._machine.prismatic[j] else f"{math.degrees(rate):+.1f} °/s"
            share = math.copysign(math.sqrt(abs(rate) / most), rate)  # so that creeping still shows
            joints.add_row(Text(name), Text(centred_bar(share), style="cyan"), Text(speed))
        said = "" if near is None else f"{progress.link} to {progress.limit}"
        why = trace.reasons[0].text if trace.reasons else ""
        title = Text(f"{progress.t_s:6.2f} s · {progress.words} ({progress.step + 1} of {progress.steps})")
        lines = (
            Text(said, style="dim", overflow="ellipsis", no_wrap=True),
            Text(why, overflow="ellipsis", no_wrap=True),
        )
        body = Group(rows, *lines, Text(), joints)
        return Panel(body, title=title, title_align="left", width=min(84, self._live.console.width))


def _grid() -> Table:
    """Return an empty grid of name, bar and number."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", justify="right", min_width=10)
    grid.add_column(no_wrap=True)
    grid.add_column(justify="right", min_width=9)
    return grid


def plain_bar(console: Console) -> tuple[ProgressBar, Callable[[Progress], None]]:
    """Return a progress bar over the drive's steps, and the callback that moves it."""
    progress_bar = ProgressBar(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True
    )
    task = progress_bar.add_task("running", total=None)

    def move(progress: Progress) -> None:
        if progress.result.t_s % 0.1 < 0.011:
            words = f"{progress.t_s:.1f} s · {progress.words}"
            progress_bar.update(task, total=progress.steps, completed=progress.step, description=words)

    return progress_bar, move
