"""Compiled code is kept by the text of everything it may call."""

import importlib.util
import os
import stat
from pathlib import Path

import numba

from workgauge.values.compiled import KEPT, before_compiling, fingerprint, folder


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


def loaded(file: Path):  # type: ignore[no-untyped-def]
    """Return the function of a file as a new process would have it."""
    spec = importlib.util.spec_from_file_location("kernel_of_a_test", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.f


def test_what_is_compiled_is_said_once_and_what_comes_off_the_disk_is_not(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    file, said = tmp_path / "kernel_of_a_test.py", []
    file.write_text(
        "from workgauge.values.compiled import njit\n\n"
        "@njit(cache=True)\ndef g(a): return a + 1\n\n@njit(cache=True)\ndef f(a): return g(a)\n"
    )
    first = loaded(file)
    with before_compiling(lambda: said.append("one")):
        assert said == []
        assert first(1) == 2 and first(1.5) == 2.5  # four of them are compiled
    assert said == ["one"]
    with before_compiling(lambda: said.append("again")):
        assert first(1) == 2 and loaded(file)(1.5) == 2.5
    assert said == ["one"]
    file.write_text(file.read_text().replace("a + 1", "a + 2"))
    assert loaded(file)(1) == 3  # after the context nobody is told
    assert said == ["one"]
