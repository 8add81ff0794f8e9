"""Scenarios and sites that come with the program, by name."""

from importlib.resources import as_file, files
from pathlib import Path

from workgauge.values.errors import ScenarioError


def shipped_names(kind: str) -> list[str]:
    """Return the names shipped under `kind` (`scenarios`, `sites`), sorted."""
    folder = files("workgauge").joinpath("shipped", kind)
    if not folder.is_dir():
        return []
    return sorted(Path(entry.name).stem for entry in folder.iterdir() if not entry.name.startswith((".", "_")))


def shipped_path(kind: str, name: str) -> Path:
    """Return the path of a shipped file or folder."""
    with as_file(files("workgauge").joinpath("shipped", kind, name)) as path:
        return path


def shipped_site_files(name: str) -> tuple[Path, ...]:
    """Return the files of a shipped site.

    Raises:
        ScenarioError: if there is none of that name.
    """
    if name not in shipped_names("sites"):
        raise ScenarioError("no such shipped site", value=name, allowed=", ".join(shipped_names("sites")) or "none")
    return tuple(sorted(shipped_path("sites", name).glob("*.xml")))
