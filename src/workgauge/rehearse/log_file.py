"""Receiver logs: files of NMEA and UBX as they came, read in blocks; refused where nothing of it is inside."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from workgauge.values.errors import InputError

#: A block of the file read at once [bytes].
BLOCK = 1 << 16

#: Logs of more bytes than this in all are refused; an hour of a receiver at 20 Hz with four sentences has 16 MB.
LARGEST = 128 << 20

#: A port's name, as in the machine file.
_PORT = re.compile(r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")

#: Told how many bytes were read since the last call, after each block.
OnBytes = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log and the port its bytes would have arrived on."""

    path: Path
    port: str

    @property
    def size(self) -> int:
        """Length [bytes]."""
        return self.path.stat().st_size

    def blocks(self, on_bytes: OnBytes | None = None) -> Iterator[bytes]:
        """Yield the file's bytes block by block.

        Raises:
            InputError: if it cannot be read.
        """
        try:
            with self.path.open("rb") as file:
                while block := file.read(BLOCK):
                    yield block
                    if on_bytes is not None:
                        on_bytes(len(block))
        except OSError as error:
            raise InputError("the log cannot be read", file=self.path, value=error.strerror) from error


def log_files(given: list[str], ports: tuple[str, ...] = ()) -> tuple[LogFile, ...]:
    """Return the logs of `FILE` or `PORT=FILE` arguments, each a readable file with something inside.

    Args:
        given: the arguments. ports: those of the machine's receivers. Files without a port take these in their order,
            as far as there are any; else `gnss`, `gnss-2` ...

    Raises:
        InputError: for what is no log, and for files that do not fit the machine's ports.
    """
    if not given:
        raise InputError("no log", allowed="one or several files")
    split = [_split(one) for one in given]
    named = {port for port, _ in split if port is not None}
    free = [port for port in ports if port not in named]
    unknown = sorted(named - set(ports)) if ports else []
    nameless = sum(port is None for port, _ in split)
    if unknown or (ports and nameless > len(free)):
        raise InputError(
            "the machine has no receiver on such a port" if unknown else "more logs than the machine has receivers",
            element="LOG",
            value=unknown[0] if unknown else f"{len(split)} logs",
            allowed=", ".join(f"{port}=FILE" for port in ports),
        )
    if not ports:
        free = [port for i in range(len(split)) if (port := f"gnss-{i + 1}" if i else "gnss") not in named]
    logs = tuple(LogFile(checked(path), port or free.pop(0)) for port, path in split)
    total = sum(log.size for log in logs)
    if total > LARGEST:
        what = f"{total:,} bytes"
        raise InputError(
            "the logs are too large",
            file=max(logs, key=lambda log: log.size).path,
            value=what,
            allowed=f"up to {LARGEST:,} in all: take a part of them",
        )
    return logs


def checked(path: Path) -> Path:
    """Return the path if it is a log that can be looked at.

    Raises:
        InputError: for what is missing, no regular file, or empty.
    """
    try:
        if not path.exists():
            raise InputError("no such file", file=path)
        if not path.is_file():
            what = "a directory" if path.is_dir() else "no regular file"
            raise InputError(f"is {what}", file=path, allowed="a file with a receiver's NMEA or UBX")
        size = path.stat().st_size
        with path.open("rb"):
            pass
    except (OSError, ValueError) as error:
        words = getattr(error, "strerror", None) or str(error)
        raise InputError("the log cannot be read", file=path, value=words) from error
    if size == 0:
        raise InputError("the file is empty", file=path, allowed="a receiver's NMEA or UBX")
    return path


def _split(argument: str) -> tuple[str | None, Path]:
    """Return (port or None, file) of `PORT=FILE` or `FILE`; a file that is there by its whole name is that file."""
    port, equals, rest = argument.partition("=")
    if equals and _PORT.match(port) and rest and not _exists(argument):
        return port, Path(rest)
    return None, Path(argument)


def _exists(name: str) -> bool:
    try:
        return Path(name).exists()
    except (OSError, ValueError):
        return False
