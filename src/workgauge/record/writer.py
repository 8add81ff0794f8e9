"""Writing the log: MCAP with JSON messages, in small chunks, each on its way to the disk before the next is begun."""

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.writer import CompressionType, Writer

from workgauge.record.plain import json_schema, to_plain
from workgauge.record.topics import TOPICS, Derived
from workgauge.values.errors import InputError

#: Version of the log's layout: topics, schemas, header.
FORMAT = "1"
#: Name of the metadata record that is the log's header, and MCAP's profile.
HEADER, PROFILE = "workgauge", "workgauge"
#: A chunk is closed at this size [bytes], so that no more than that is ever waiting in memory.
CHUNK_BYTES = 256 * 1024
#: A chunk is closed after so much of the log's own time [ns], so that no more than that is lost to a crash.
FLUSH_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Versions:
    """What wrote a log."""

    format: str
    workgauge: str
    python: str
    numpy: str

    @classmethod
    def here(cls) -> "Versions":
        """Return the versions running now."""
        try:
            own = version("workgauge")
        except PackageNotFoundError:
            own = "unknown"
        return cls(FORMAT, own, platform.python_version(), version("numpy"))


class LogWriter:
    """An append-only log. Writing never raises: a log that cannot be written goes silent and says so in `fault`.

    Args:
        file: a path that does not exist yet, or an open binary stream.
        configuration: what the run was set up with; plain values.
        flush_ns: longest time of the log's own clock between two chunks [ns].

    Raises:
        InputError: if the file exists already or cannot be made.
    """

    def __init__(self, file: Path | IO[bytes], configuration: Mapping[str, Any], *, flush_ns: int = FLUSH_NS) -> None:
        self.fault: str | None = None
        self.lost = 0
        self._own = isinstance(file, Path)
        self._stream: IO[bytes] = _made(file) if isinstance(file, Path) else file
        self._flush_ns, self._flushed_ns = flush_ns, None if flush_ns > 0 else 0
        self._closed = False
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels: dict[str, tuple[int, int]] = {}
        header = {**asdict(Versions.here()), "configuration": _text(to_plain(configuration))}
        try:
            self._writer.start(profile=PROFILE)
            self._writer.add_metadata(HEADER, header)
            self._stream.flush()
        except (OSError, McapError) as error:
            raise InputError("the log cannot be written", value=str(error)) from error

    def write(self, topic: str, now_ns: int, value: object) -> None:
        """Append one value under a topic of `topics.TOPICS` or one derived for display, at a time of the log's clock.

        A value that cannot be written, for whatever reason, is counted in `lost`.
        """
        if self.fault is not None or self._closed:
            self.lost += 1
            return
        try:
            channel, sequence = self._channels.get(topic) or (self._register(topic, value), 0)
            data = value.data if isinstance(value, Derived) else to_plain(value)
            self._writer.add_message(channel, now_ns, _text(data).encode(), now_ns, sequence)
            self._channels[topic] = channel, (sequence + 1) % 2**32
            if self._flushed_ns is None or not 0 <= now_ns - self._flushed_ns < self._flush_ns:
                self._flushed_ns = now_ns
                self._writer.flush()  # type: ignore[no-untyped-call]
        except (OSError, McapError, ValueError, TypeError) as error:
            self.fault = f"{topic}: {error}"
            self.lost += 1

    def close(self) -> None:
        """Finish the log with its index; a second call does nothing.

        Raises:
            InputError: if something could not be written, saying what was lost.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self.fault is None:
                self._writer.finish()  # type: ignore[no-untyped-call]
            if self._own:
                self._stream.close()
        except (OSError, ValueError) as error:
            self.fault = self.fault or str(error)
        if self.fault is not None:
            raise InputError("the log is incomplete", value=self.fault, allowed=f"{self.lost} messages lost")

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _register(self, topic: str, value: object) -> int:
        name, schema = (value.schema_name, value.schema) if isinstance(value, Derived) else _schema_of(topic)
        schema_id = self._writer.register_schema(name, "jsonschema", _text(schema).encode())
        return self._writer.register_channel(topic, "json", schema_id)


def _schema_of(topic: str) -> tuple[str, dict[str, Any]]:
    kind = TOPICS[topic]
    name = f"workgauge.{kind.__name__}"
    return name, {"title": name, **json_schema(kind)}


def _text(plain: Any) -> str:
    return json.dumps(plain, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _made(path: Path) -> IO[bytes]:
    try:
        return path.open("xb")
    except FileExistsError:
        raise InputError("there is a file already; a log is never written over", file=path) from None
    except (OSError, ValueError) as error:
        raise InputError("the log cannot be made there", file=path, value=str(error)) from error
