"""Numbers of very many equal elements (points and faces of surfaces), collected in chunks to keep memory small."""

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from workgauge.values.arrays import Ints
from workgauge.values.errors import SiteError

#: Rows of float64 (points) or int64 (faces).
Numbers: TypeAlias = NDArray[Any]

_CHUNK = 65536
#: No coordinate is larger, in whatever unit.
_LARGEST = 1e12


def line_of(element: "etree._Element") -> int | None:
    """Return the line an element starts on, if known."""
    line: Any = element.sourceline
    return int(line) if line else None


class NumberBlock:
    """The texts of `P` or `F` elements of one parent as arrays.

    After `close`: `values` (n, 3) float64 for points [file's unit] or int64 for faces, `ids` (n,) int64 of the
    points, `lines` (n,) of each row in the file. Invisible faces (`i="1"`) are left out and counted in `invisible`.
    """

    def __init__(self, path: Path, kind: str) -> None:
        self._path = path
        self._kind = kind
        self._dtype: type[np.float64] | type[np.int64] = np.float64 if kind == "P" else np.int64
        self._texts: list[str] = []
        self._ids: list[str] = []
        self._rows: list[int] = []
        self._parts: list[Numbers] = []
        self._id_parts: list[Ints] = []
        self._line_parts: list[Ints] = []
        self.invisible = 0
        self.quads = 0
        self.values: Numbers = np.empty((0, 3), dtype=self._dtype)
        self.ids: Ints = np.empty(0, dtype=np.int64)
        self.lines: Ints = np.empty(0, dtype=np.int64)

    def add(self, element: "etree._Element") -> None:
        """Take one element."""
        if self._kind == "P":
            self._ids.append(element.get("id") or "")
        elif element.get("i") == "1":
            self.invisible += 1
            return
        self._texts.append(element.text or "")
        self._rows.append(line_of(element) or 0)
        if len(self._texts) >= _CHUNK:
            self._flush()

    def close(self) -> None:
        """Turn what was taken into arrays.

        Raises:
            SiteError: a point without id or three finite coordinates, a face that is not three or four whole numbers.
        """
        self._flush()
        if self._parts:
            self.values = np.concatenate(self._parts)
            self.lines = np.concatenate(self._line_parts)
            self.ids = np.concatenate(self._id_parts) if self._id_parts else self.ids
        self._parts, self._id_parts, self._line_parts = [], [], []

    def _flush(self) -> None:
        if not self._texts:
            return
        lines = np.array(self._rows, dtype=np.int64)
        widths = np.array([len(text.split()) for text in self._texts])
        values = self._parse(self._texts, widths)
        if self._kind == "F" and (widths == 4).any():
            values, lines = self._split_quads(values, widths, lines)
        self._parts.append(values.reshape(-1, 3))
        self._line_parts.append(lines)
        if self._kind == "P":
            self._id_parts.append(self._parse_ids())
        self._texts, self._ids, self._rows = [], [], []

    def _parse(self, texts: list[str], widths: Ints) -> Numbers:
        allowed = (3,) if self._kind == "P" else (3, 4)
        good = bool(np.isin(widths, allowed).all())
        values = np.empty(0, dtype=self._dtype)
        if good:
            try:
                values = np.fromstring(" ".join(texts), dtype=self._dtype, sep=" ")
            except ValueError:
                good = False
        if good and len(values) == widths.sum() and (self._kind == "F" or (np.abs(values) <= _LARGEST).all()):
            return values
        raise self._first_fault(texts, allowed)

    def _first_fault(self, texts: list[str], allowed: tuple[int, ...]) -> SiteError:
        what = "northing easting height" if self._kind == "P" else "three point ids"
        for row, text in enumerate(texts):
            words = text.split()
            try:
                finite = self._kind == "F" or all(abs(float(word)) <= _LARGEST for word in words)
                numbers = [int(word) for word in words] if self._kind == "F" else words
            except ValueError:
                finite, numbers = False, []
            if len(numbers) not in allowed or not finite:
                name = f"P id {self._ids[row]}" if self._kind == "P" else "F"
                message = (
                    "a point of a surface needs three finite numbers" if self._kind == "P" else "a face is not valid"
                )
                return SiteError(
                    message,
                    file=self._path,
                    line=self._rows[row],
                    element=name,
                    value=" ".join(words) or "nothing",
                    allowed=what,
                )
        return SiteError("numbers that cannot be read", file=self._path, line=self._rows[0], allowed=what)

    def _parse_ids(self) -> Ints:
        try:
            return np.array([int(i) for i in self._ids], dtype=np.int64)
        except (ValueError, OverflowError):
            for row, text in enumerate(self._ids):
                if not text.strip().isdecimal() or len(text.strip()) > 18:
                    raise SiteError(
                        "point without a usable id",
                        file=self._path,
                        line=self._rows[row],
                        element="P",
                        value=text or "none",
                        allowed="a whole number",
                    ) from None
            raise SiteError("point ids that cannot be read", file=self._path, line=self._rows[0]) from None

    def _split_quads(self, values: Numbers, widths: Ints, lines: Ints) -> tuple[Numbers, Ints]:
        """Return two triangles for each face of four points."""
        first = np.cumsum(widths) - widths
        head = first[:, None] + np.arange(3)
        four = np.flatnonzero(widths == 4)
        tail = first[four][:, None] + np.array([0, 2, 3])
        self.quads += len(four)
        return values[np.concatenate([head, tail])], np.concatenate([lines, lines[four]])
