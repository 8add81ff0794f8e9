"""Reading the log, whole or cut: everything up to the last complete chunk, bit for bit as it was written."""

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import CRCValidationError, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from workgauge.record.plain import from_plain
from workgauge.record.topics import TOPICS
from workgauge.record.writer import FORMAT, HEADER, Versions
from workgauge.values.errors import InputError

_HEAD = struct.Struct("<BQ")
#: What mcap raises for bytes that are not what they should be.
_BROKEN = (McapError, CRCValidationError, ValueError, struct.error, zlib.error, EOFError, KeyError, RuntimeError)
#: No record of ours is larger [bytes].
LARGEST_RECORD = 64 * 1024 * 1024
#: No chunk of ours unpacks to more [bytes].
LARGEST_CHUNK = 256 * 1024 * 1024


class Entry(NamedTuple):
    """One message: its topic, the log's time [ns] and the value."""

    topic: str
    time_ns: int
    value: Any


@dataclass(frozen=True, slots=True)
class Log:
    """A log on disk.

    Attributes:
        file: where it is. versions: what wrote it. configuration: what the run was set up with.
        cut: where a log that was never finished ends in the file [bytes], or None for a finished one.
        chunks: where its complete chunks begin, and how long they are [bytes].
    """

    file: Path
    versions: Versions
    configuration: Mapping[str, Any]
    cut: int | None
    chunks: tuple[tuple[int, int], ...]

    def entries(self, *topics: str) -> Iterator[Entry]:
        """Yield the values of these topics (all, without), in the order they were written.

        Raises:
            InputError: for a damaged chunk or message, saying at which byte.
        """
        names: dict[int, str] = {}
        with _opened(self.file) as stream:
            for offset, length in self.chunks:
                stream.seek(offset)
                for record in self._unpacked(offset, stream.read(length)):
                    if isinstance(record, Channel):
                        names[record.id] = record.topic
                    elif isinstance(record, Message):
                        topic = names.get(record.channel_id, "")
                        if topic in TOPICS and (not topics or topic in topics):
                            yield Entry(topic, record.log_time, self._value(offset, topic, record.data))

    def _unpacked(self, offset: int, body: bytes) -> list[Any]:
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            if chunk.uncompressed_size > LARGEST_CHUNK:
                raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
            return breakup_chunk(chunk, validate_crc=True)
        except Exception as error:  # zstandard has errors of its own, without a common root
            raise InputError("damaged chunk", file=self.file, element=f"byte {offset}", value=str(error)) from error

    def _value(self, offset: int, topic: str, data: bytes) -> Any:
        try:
            return from_plain(TOPICS[topic], json.loads(data))
        except (ValueError, TypeError, RecursionError) as error:
            place = f"chunk at byte {offset}, {topic}"
            raise InputError("not a message of this program", file=self.file, element=place, value=error) from error


def open_log(path: Path) -> Log:
    """Return a log with its header read and its complete chunks found.

    Raises:
        InputError: if the file cannot be read, is no MCAP file or not a log of this program.
    """
    with _opened(path) as stream:
        try:
            size = stream.seek(0, 2)
            stream.seek(0)
            if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise InputError("not an MCAP file", file=path)
            header, chunks, end = _scanned(stream, size)
        except OSError as error:
            raise InputError("the log cannot be read", file=path, value=error.strerror) from error
    if header is None:
        raise InputError("not a log of this program: it has no header", file=path, element=HEADER)
    if header.get("format") != FORMAT:
        raise InputError("a log of another format", file=path, value=header.get("format"), allowed=FORMAT)
    try:
        configuration = json.loads(header["configuration"])
        versions = Versions(*(header[name] for name in Versions.__slots__))
    except (KeyError, ValueError, RecursionError) as error:
        raise InputError("its header is broken", file=path, element=HEADER, value=str(error)) from None
    if not isinstance(configuration, dict):
        raise InputError("its header is broken", file=path, element="configuration")
    return Log(path, versions, configuration, end, tuple(chunks))


def _scanned(stream: IO[bytes], size: int) -> tuple[Mapping[str, str] | None, list[tuple[int, int]], int | None]:
    """Return the header, the chunks (offset, length) and where a log without an end is cut, by the records' heads."""
    header: Mapping[str, str] | None = None
    chunks: list[tuple[int, int]] = []
    while True:
        at = stream.tell()
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return header, chunks, at
        opcode, length = _HEAD.unpack(head)
        begin = at + _HEAD.size
        if opcode == Opcode.DATA_END and begin + length <= size:
            return header, chunks, None
        if opcode == 0 or length > LARGEST_RECORD or begin + length > size:
            return header, chunks, at
        if opcode == Opcode.CHUNK:
            chunks.append((begin, length))
        elif opcode == Opcode.METADATA and header is None:
            try:
                record = Metadata.read(ReadDataStream(BytesIO(stream.read(length))))
            except _BROKEN:
                return header, chunks, at
            header = record.metadata if record.name == HEADER else None
        stream.seek(begin + length)


def _opened(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError("the log cannot be read", file=path, value=reason) from error
