"""Compiled code is kept by the text of everything it may call."""

import os
import stat
from pathlib import Path

from workgauge.values.compiled import KEPT, fingerprint, folder


def package(at: Path) -> Path:
    """Return a package with a compiled file, one without, and one in a subfolder."""
    (at / "deep").mkdir(parents=True)
    (at / "plain.py").write_text("a = 1\n")
    (at / "kernel.py").write_text("@njit\ndef f(): return 1\n")
    (at / "deep" / "called.py").write_text("@njit\ndef g(): return 2\n")
    return at


def test_any_compiled_file_names_another_folder(tmp_path: Path) -> None:
    root = package(tmp_path / "p")
    first = fingerprint(root)
    assert fingerprint(root) == first
    (root / "plain.py").write_text("a = 2\n")
    assert fingerprint(root) == first
    (root / "deep" / "called.py").write_text("@njit\ndef g(): return 3\n")
    changed = fingerprint(root)
    assert changed != first
    (root / "deep" / "called.py").rename(root / "deep" / "renamed.py")
    assert fingerprint(root) not in {first, changed}


def test_folders_of_old_versions_go_but_for_the_newest(tmp_path: Path) -> None:
    root = package(tmp_path / "p")
    made = []
    for version in range(KEPT + 4):
        (root / "kernel.py").write_text(f"@njit\ndef f(): return {version}\n")
        made.append(folder(root))
        os.utime(made[-1], (version, version))
    assert [path.exists() for path in made] == [False] * 3 + [True] * (KEPT + 1)


def test_a_package_that_cannot_be_written_to_uses_the_users_cache(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    root = package(tmp_path / "p")
    (root / "__pycache__").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert folder(root).parent == tmp_path / "cache" / "workgauge"
    (tmp_path / "cache").rename(tmp_path / "gone")
    (tmp_path / "cache").write_text("no folder either")
    last = folder(root)
    assert last.is_dir() and last.stat().st_mode & stat.S_IWUSR
