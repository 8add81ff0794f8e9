"""What `workgauge run --preview` shows: whether the automatic steps of a drive complete, and how near they come."""

from collections.abc import Sequence

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from workgauge.app.output import busy, print_json, stderr, stdout, warn
from workgauge.rehearse.automatic import AutoStep
from workgauge.rehearse.preview_drive import DrivePreview, preview_drive
from workgauge.rehearse.run import Plans, planned_drive
from workgauge.rehearse.scenario import Step
from workgauge.rehearse.session import Session

#: Exit code where a step would not complete.
EXIT_INCOMPLETE = 1


def planned_meanwhile(session: Session, steps: Sequence[Step]) -> Plans:
    """Return the plans of a drive's automatic steps, with something to look at while they are made."""
    automatic = any(isinstance(step, AutoStep) for step in steps)
    with busy("planning the automatic steps" if automatic else None):
        return planned_drive(session, steps)


def previewed(session: Session, steps: Sequence[Step], as_json: bool) -> None:
    """Show what would become of the automatic steps; exit code 1 if one of them would not complete.

    Raises:
        ScenarioError: for a step that cannot be planned, or none at all.
    """
    found = _previewed(session, steps)
    if as_json:
        print_json(found.as_json())
    else:
        _show(found)
    if not found.completed:
        raise typer.Exit(EXIT_INCOMPLETE)


def _previewed(session: Session, steps: Sequence[Step]) -> DrivePreview:
    console = stderr()
    if not console.is_terminal:
        return preview_drive(session, steps)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("planning", total=None)
        return preview_drive(
            session, steps, lambda t_s: progress.update(task, description=f"previewing, {t_s:.1f} s of motion")
        )


def _show(found: DrivePreview) -> None:
    console = stdout()
    for step, words in zip(found.steps, found.words, strict=True):
        console.print(words, style="green" if step.preview.completed else "bold red")
    warn([f"step {step.number}: {note}" for step in found.steps for note in step.notes])
    warn([f"not previewed: {words}" for words in found.left_out])
