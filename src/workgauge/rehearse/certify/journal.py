"""The drives that are done, on disk: JSON lines, appended as they come; of one certificate and no other."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from workgauge.rehearse.certify.conditions import Task
from workgauge.rehearse.certify.driving import Driven
from workgauge.rehearse.certify.fingerprint import differences
from workgauge.values.errors import InputError

_HEAD = "workgauge certify"


class Journal:
    """A journal file: its first line says what of, every other is one drive.

    Args:
        path: of the file; need not exist. fingerprint: of the certificate.

    Raises:
        InputError: if the file is no journal, or one of another certificate, naming what differs.
    """

    def __init__(self, path: Path, fingerprint: Mapping[str, Any]) -> None:
        self.path = path
        self.known: dict[Task, Driven] = {}
        head = {"journal": _HEAD, "of": json.loads(json.dumps(fingerprint))}
        try:
            lines = path.read_bytes().split(b"\n") if path.exists() else []
        except OSError as error:
            raise InputError("the journal cannot be read", file=path, value=error.strerror) from error
        if any(lines):
            self._take(lines, head)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("ab") as file:
                if not any(lines):
                    file.truncate(0)
                    file.write(json.dumps(head).encode() + b"\n")
                elif lines[-1]:  # the last line was cut off: what follows begins on a line of its own
                    file.write(b"\n")
        except OSError as error:
            raise InputError("the journal cannot be written", file=path, value=error.strerror) from error

    def append(self, task: Task, driven: Driven) -> None:
        """Add one drive; it is on disk when this returns.

        Raises:
            InputError: if it cannot be written any more.
        """
        try:
            with self.path.open("ab") as file:
                file.write(json.dumps(driven.plain(), allow_nan=False).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError("the journal cannot be written", file=self.path, value=error.strerror) from error
        self.known[task] = driven

    def _take(self, lines: list[bytes], wanted: Mapping[str, Any]) -> None:
        try:
            head = json.loads(lines[0])
        except ValueError:
            head = None
        if not isinstance(head, dict) or head.get("journal") != _HEAD or not isinstance(head.get("of"), dict):
            raise InputError(
                "this is no journal of drives",
                file=self.path,
                line=1,
                allowed="a new file, or one that certify wrote",
            )
        other = differences(head["of"], wanted["of"])
        if other:
            raise InputError(
                f"these drives are of another certificate, it differs in {', '.join(other)}",
                file=self.path,
                allowed="a new file, or the same machine, rules, site, guard, seed and program",
            )
        for line in lines[1:]:
            try:
                driven = Driven.of_plain(json.loads(line))
            except (ValueError, KeyError, TypeError):
                continue  # cut off: driven again
            self.known[Task(driven.condition, driven.seed)] = driven
