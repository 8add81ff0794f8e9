"""Running the command line in this process, and small site files for it."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from workgauge.app.cli import app
from workgauge.app.output import COMPILING
from workgauge.rehearse.shipped import shipped_path

E0, N0 = 25_500_000, 6_700_000


@dataclass(frozen=True)
class Answer:
    """What a command answered."""

    code: int
    out: str
    err: str

    @property
    def data(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        assert self.code == 0, self.err
        found: dict[str, Any] = json.loads(self.out)
        return found


def workgauge(*arguments: object) -> Answer:
    """Run the command line; exceptions that are not an exit go their way."""
    done = CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)
    return Answer(done.exit_code, done.stdout, done.stderr)


def refused(answer: Answer, *words: str) -> None:
    """Check for exit code 2, nothing on stdout and one line on stderr with these words, compiling aside."""
    assert answer.code == 2, (answer.out, answer.err)
    assert answer.out == ""
    (line,) = (line for line in answer.err.splitlines() if line != COMPILING)
    assert line.startswith("workgauge: ")
    for word in words:
        assert re.search(word, line, flags=re.IGNORECASE), line


def document(*parts: str, crs: str = '<CoordinateSystem name="ETRS89 / GK25FIN" epsgCode="3879"/>') -> str:
    """Return a LandXML document in metres with these parts."""
    units = '<Units><Metric linearUnit="meter" directionUnit="radians"/></Units>'
    space = "http://www.landxml.org/schema/LandXML-1.2"
    return (
        f'<?xml version="1.0"?>\n<LandXML xmlns="{space}" version="1.2">\n{units}\n{crs}\n'
        + "\n".join(parts)
        + "\n</LandXML>\n"
    )


def line(start: tuple[float, float], end: tuple[float, float]) -> str:
    """Return a straight element between (east, north) offsets."""
    (a, b), (c, d) = start, end
    return f"<Line><Start>{N0 + b} {E0 + a}</Start><End>{N0 + d} {E0 + c}</End></Line>"


def alignment(*elements: str, rest: str = "", name: str = "Track 1") -> str:
    """Return an alignment of these elements, stations from 1000."""
    geometry = "\n".join(elements)
    return (
        f'<Alignments><Alignment name="{name}" staStart="1000"><CoordGeom>\n{geometry}\n</CoordGeom>\n{rest}'
        "</Alignment></Alignments>"
    )


def profile(height: float) -> str:
    """Return a level profile over stations 1000 to 1200."""
    return f"<Profile><ProfAlign name='p'><PVI>1000 {height}</PVI><PVI>1200 {height}</PVI></ProfAlign></Profile>"


def surface(points: str, faces: str) -> str:
    """Return a surface of these points and faces."""
    return (
        f'<Surfaces><Surface name="ground"><Definition surfType="TIN"><Pnts>{points}</Pnts>'
        f"<Faces>{faces}</Faces></Definition></Surface></Surfaces>"
    )


STRAIGHT = line((0, 0), (0, 200))
_PLACE = f"{N0 + 100} {E0 + 8} 50"
POLE = f'<CgPoints name="Poles" desc="Pole"><CgPoint name="P7" desc="Pole">{_PLACE}</CgPoint></CgPoints>'


@pytest.fixture
def write(tmp_path: Path):  # type: ignore[no-untyped-def]
    """Return a function that writes a file and returns its path."""

    def write_file(text: str | bytes, name: str = "site.xml") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write_file


@pytest.fixture(scope="session")
def shipped() -> Path:
    """Return the folder of the shipped site."""
    return shipped_path("sites", "double_track")


class Tools:
    """What the tests of this folder share."""

    workgauge = staticmethod(workgauge)
    refused = staticmethod(refused)
    document = staticmethod(document)
    line = staticmethod(line)
    alignment = staticmethod(alignment)
    profile = staticmethod(profile)
    surface = staticmethod(surface)
    STRAIGHT = STRAIGHT
    POLE = POLE
    E0, N0 = E0, N0


@pytest.fixture(scope="session")
def cli() -> type[Tools]:
    return Tools
