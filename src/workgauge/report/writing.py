"""Writing a report: all its files or none."""

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from workgauge.values.errors import InputError


def write_files(folder: Path, texts: Mapping[str, str]) -> None:
    """Write named texts into `folder`, made if needed; nothing half-written is ever left there.

    Args:
        folder: where. texts: file name to what goes into it; the last is put in place last.

    Raises:
        InputError: if the folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=".report-", dir=folder))
        try:
            for name, text in texts.items():
                (work / name).write_text(text, "utf-8")
            for name in texts:
                target = (folder / name).resolve()
                if target.exists() and not target.is_file():
                    raise InputError("is not a regular file", file=target, allowed="a file to be written")
                (work / name).replace(target)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    except OSError as error:
        raise InputError("the report cannot be written there", file=folder, value=error.strerror) from error
