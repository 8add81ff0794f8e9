"""The file of start-of-shift checks: a line is added at its end and never another touched; arming reads the last."""

import os
import time
from pathlib import Path

from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import Thresholds
from workgauge.positioning.check import CheckResult, not_valid
from workgauge.positioning.check_log import last_check, line_of
from workgauge.values.errors import InputError

#: Checks are a few hundred bytes each; a file beyond this is another's.
LARGEST = 64 << 20


def append_check(path: Path, result: CheckResult) -> None:
    """Add a check to a file, on the disk before this returns. An interruption costs this line at most.

    Raises:
        InputError: if the file cannot be written, or holds no lines.
    """
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            size = os.fstat(handle).st_size
            torn = size > 0 and os.pread(handle, 1, size - 1) != b"\n"
            data = (b"\n" if torn else b"") + line_of(result).encode() + b"\n"
            while data:
                data = data[os.write(handle, data) :]
            os.fsync(handle)
        finally:
            os.close(handle)
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError("cannot write the check", file=path, value=reason) from error


def newest_check(path: Path, machine: MachineModel) -> CheckResult | None:
    """Return the newest check of this machine and attachment in a file, the file's last if there is none of it.

    Raises:
        InputError: if the file cannot be read, or none of its lines is a check.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise InputError("this is no file of checks", file=path, allowed=f"up to {LARGEST >> 20} MB")
        lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError("cannot read the checks", file=path, value=reason) from error
    result, _ = last_check(lines, machine.name, machine.attachment)
    if result is None:
        raise InputError("no check in this file", file=path, allowed="lines that `workgauge check` has written")
    return result


def utc_now_ns() -> int:
    """Return the wall clock [ns since 1970, UTC]."""
    return time.time_ns()


def refuse_unchecked(machine: MachineModel, path: Path | None) -> bool:
    """Refuse to arm a machine on a check that is not valid now; return whether there is a valid one.

    Without a file it is refused only if the machine's file asks for a check.

    Raises:
        InputError: with the reason.
    """
    thresholds = Thresholds() if machine.positioning is None else machine.positioning.thresholds
    if path is None:
        if thresholds.check_required:
            raise InputError(
                "the machine's file asks for a start-of-shift check",
                element="check_required",
                allowed="--check FILE, as `workgauge check` has written it",
            )
        return False
    why = not_valid(newest_check(path, machine), machine, utc_now_ns(), thresholds)
    if why is not None:
        raise InputError(
            f"not armed: {why}", file=path, allowed="a check that passed, of this machine, of this shift"
        )
    return True
