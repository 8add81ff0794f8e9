"""Numbers of very many equal elements (points and faces of surfaces), collected in chunks to keep memory small."""

from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from workgauge.site.landxml.numbers import HOW_TO_WRITE, fault, to_int
from workgauge.values.arrays import Ints
from workgauge.values.errors import SiteError

#: Rows of float64 (points) or int64 (faces).
Numbers: TypeAlias = NDArray[Any]

_CHUNK = 65536
#: Whole numbers that were too large come out of the fast reader as one of these.
_SATURATED = (-(2**63), 2**63 - 1)


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
        words = [text.split() for text in self._texts]
        widths = np.array([len(row) for row in words])
        values = self._parse(words, widths)
        if self._kind == "F" and (widths == 4).any():
            values, lines = self._split_quads(values, widths, lines)
        self._parts.append(values.reshape(-1, 3))
        self._line_parts.append(lines)
        if self._kind == "P":
            self._id_parts.append(self._parse_ids())
        self._texts, self._ids, self._rows = [], [], []

    def _parse(self, words: list[list[str]], widths: Ints) -> Numbers:
        allowed = (3,) if self._kind == "P" else (3, 4)
        good = bool(np.isin(widths, allowed).all())
        values = np.empty(0, dtype=self._dtype)
        if good:
            try:
                values = np.fromstring(" ".join(chain.from_iterable(words)), dtype=self._dtype, sep=" ")
            except ValueError:
                good = False
        if good and len(values) == widths.sum():
            right = np.isfinite(values) if self._kind == "P" else ~np.isin(values, _SATURATED)
            if right.all():
                return values
        raise self._first_fault(words, allowed)

    def _first_fault(self, words: list[list[str]], allowed: tuple[int, ...]) -> SiteError:
        points = self._kind == "P"
        row = next((i for i, given in enumerate(words) if len(given) not in allowed or self._is_wrong(given)), 0)
        return SiteError(
            "a point of a surface needs three finite numbers" if points else "a face is not valid",
            file=self._path,
            line=self._rows[row] or None,
            element=f"P id {self._ids[row]}" if points else "F",
            value=" ".join(words[row]) or "nothing",
            allowed=f"northing easting height, {HOW_TO_WRITE}" if points else "three point ids",
        )

    def _is_wrong(self, words: list[str]) -> bool:
        if self._kind == "P":
            return fault(words) is not None
        try:
            return not [to_int(word) for word in words]
        except ValueError:
            return True

    def _parse_ids(self) -> Ints:
        ids: list[int] = []
        for row, text in enumerate(self._ids):
            try:
                ids.append(to_int(text))
            except ValueError:
                raise SiteError(
                    "point without a usable id",
                    file=self._path,
                    line=self._rows[row] or None,
                    element="P",
                    value=text or "none",
                    allowed="a whole number",
                ) from None
        return np.array(ids, dtype=np.int64)

    def _split_quads(self, values: Numbers, widths: Ints, lines: Ints) -> tuple[Numbers, Ints]:
        """Return two triangles for each face of four points."""
        first = np.cumsum(widths) - widths
        head = first[:, None] + np.arange(3)
        four = np.flatnonzero(widths == 4)
        tail = first[four][:, None] + np.array([0, 2, 3])
        self.quads += len(four)
        return values[np.concatenate([head, tail])], np.concatenate([lines, lines[four]])
