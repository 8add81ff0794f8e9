"""What a certificate is of, as check sums: another machine, site, program or setting gives another certificate."""

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from workgauge import __version__
from workgauge.machine.load import read_description
from workgauge.rehearse.certify.conditions import DT_S, MISSED, NEAR_M, SUBSTEPS
from workgauge.rehearse.certify.driving import Driver
from workgauge.values.errors import InputError

#: Libraries whose versions may change the last bit of a number.
LIBRARIES = ("numpy", "scipy", "numba", "daqp")
_PACKAGE = Path(__file__).resolve().parents[2]

Fingerprint = dict[str, Any]


def fingerprint(driver: Driver, seed: int) -> Fingerprint:
    """Return what a certificate's drives are of; plain values, equal for equal drives.

    Neither the number of drives nor of injected delays is part of it: every drive stands for itself.

    Raises:
        InputError: if a file cannot be read any more.
    """
    subject = driver.subject
    return {
        "machine": {
            "name": driver.machine.name,
            "attachment": driver.machine.attachment,
            **_machine(subject.machine),
        },
        "rule book": {"name": Path(subject.rules).name, "sha256": _rules(subject.rules)},
        "site": {
            "epsg": subject.epsg,
            "files": [{"name": Path(one).name, "sha256": check_sum(Path(one))} for one in subject.site_files],
        },
        "guard": {"name": subject.guard, "parameters": _parameters(driver)},
        "drives": {
            "stop_distance_m": driver.stop_distance_m,
            "seconds": subject.seconds,
            "dt_s": DT_S,
            "substeps": SUBSTEPS,
            "near_m": NEAR_M,
            "missed": MISSED,
        },
        "seed": seed,
        "program": {"version": __version__, "sha256": program_sum()},
        "libraries": {"python": platform.python_version(), **{name: metadata.version(name) for name in LIBRARIES}},
    }


def differences(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Return in words what differs between two fingerprints."""
    words = {"drives": "settings of the drives", "libraries": "versions of libraries", "program": "program version"}
    names = sorted({*known, *wanted}, key=[*wanted, *known].index)
    return [words.get(name, name) for name in names if known.get(name) != wanted.get(name)]


def check_sum(path: Path) -> str:
    """Return a file's SHA-256 as hexadecimal digits.

    Raises:
        InputError: if it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError("cannot be read", file=path, value=error.strerror) from error


@cache
def program_sum() -> str:
    """Return the SHA-256 of the program's own source files, names and texts."""
    digest = hashlib.sha256()
    for file in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(file.relative_to(_PACKAGE)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _machine(name: str) -> Fingerprint:
    path, content = read_description(name)
    found: Fingerprint = {"sha256": check_sum(path)}
    chain = content.get("urdf")
    if isinstance(chain, dict):
        found["urdf_sha256"] = check_sum(path.parent / str(chain.get("file")))
    return found


def _rules(name: str) -> str:
    path = Path(name)
    if not path.exists():
        path = Path(str(resources.files("workgauge") / "shipped" / "rules" / f"{name}.yaml"))
    return check_sum(path)


def _parameters(driver: Driver) -> Fingerprint:
    return {key: str(value) if isinstance(value, tuple) else value for key, value in asdict(driver.guard).items()}  # type: ignore[call-overload]
