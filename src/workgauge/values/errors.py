"""One root for every error the program raises on purpose, carrying the facts and not only a sentence."""

from pathlib import Path


class WorkgaugeError(Exception):
    """Something workgauge refuses, with the facts a person needs to mend it.

    Args:
        message: what is wrong, one sentence, no trailing full stop.
        file: the file it stands in, if any.
        line: the line in that file, counted from 1.
        element: the element, key or feature inside the file.
        value: the offending value, as found.
        allowed: what would have been accepted, in words.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        element: str | None = None,
        value: object = None,
        allowed: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.element = element
        self.value = value
        self.allowed = allowed
        super().__init__(str(self))

    def __str__(self) -> str:
        place = self.file or ""
        if self.line is not None:
            place = f"{place}:{self.line}" if place else f"line {self.line}"
        if self.element:
            element = _one_line(self.element)
            place = f"{place}: {element}" if place else element
        facts = []
        if self.value is not None:
            shown = _one_line(str(self.value))
            facts.append(f"found {shown if len(shown) <= 120 else shown[:117] + '...'}")
        if self.allowed:
            facts.append(f"allowed: {self.allowed}")
        text = f"{place}: {self.message}" if place else self.message
        return f"{text} ({'; '.join(facts)})" if facts else text


def _one_line(text: str) -> str:
    """Return a text with what cannot be printed on one line escaped."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class InputError(WorkgaugeError):
    """What the user handed in cannot be used; the command line answers with exit code 2."""


class GeodesyError(InputError):
    """An unknown coordinate system, or coordinates outside the area it is made for."""


class SiteError(InputError):
    """A site file that cannot be read or contradicts itself."""


class RuleError(InputError):
    """A rule book that is not valid, or that has no answer for a feature of the site."""


class MachineError(InputError):
    """A machine description that is not valid."""


class ScenarioError(InputError):
    """A scenario that is not valid or names something that does not exist."""


class WireError(WorkgaugeError):
    """Bytes that are not a message of ours: wrong kind, length, version or check sum."""
