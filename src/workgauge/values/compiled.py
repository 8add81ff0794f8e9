"""Compiled code, kept on disk between runs, and never an old one.

numba keeps a compiled function beside its source and takes it back as long as that one file has not changed; what the
function calls in other files may have, and the old code would go on running. So all compiled code of this program is
kept in a folder named by the text of every file that has any: change one, and all of it is compiled anew.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numba
from numba.core import event

_PACKAGE = Path(__file__).resolve().parents[1]
_NAME = "kernels-"
#: Compiled code of so many other versions is kept.
KEPT = 3


def fingerprint(package: Path) -> str:
    """Return a name for the text of all files of a package that hold compiled functions, and for numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for file in sorted(package.rglob("*.py")):
        text = file.read_bytes()
        if b"njit" in text:
            digest.update(str(file.relative_to(package)).encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def folder(package: Path) -> Path:
    """Return a folder for the compiled code of a package: in it, in the user's cache, or a temporary one.

    Of those of other versions beside it the newest are kept: another process may still use one.
    """
    name = _NAME + fingerprint(package)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for parent in (package / "__pycache__", cache / "workgauge"):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(parent / name, os.W_OK):
            others = [old for old in parent.glob(_NAME + "*") if old.name != name]
            for old in sorted(others, key=_changed)[:-KEPT]:
                shutil.rmtree(old, ignore_errors=True)
            return parent / name
    return Path(tempfile.mkdtemp(prefix=f"workgauge-{_NAME}"))


@contextmanager
def before_compiling(say: Callable[[], None]) -> Iterator[None]:
    """Call `say` before the first function that is compiled while the context lasts, and only that once.

    One that is taken back from the disk is not compiled, and nothing is said of it.
    """
    with event.install_listener("numba:compile", _First(say)):
        yield


class _First(event.Listener):
    """Says the first of what begins."""

    def __init__(self, say: Callable[[], None]) -> None:
        self._say: Callable[[], None] | None = say

    def on_start(self, _: event.Event) -> None:
        """A function is about to be compiled."""
        say, self._say = self._say, None
        if say is not None:
            say()

    def on_end(self, _: event.Event) -> None:
        """It is; there is nothing to say."""


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(folder(_PACKAGE))  # type: ignore[attr-defined]

njit = numba.njit
