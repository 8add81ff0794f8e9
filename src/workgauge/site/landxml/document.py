"""Opening a LandXML file safely: no DTD, entities or network. Points and faces are taken out as they stream by."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias
from xml.parsers import expat

from lxml import etree

from workgauge.site.landxml.blocks import NumberBlock, line_of
from workgauge.site.landxml.numbers import HOW_TO_WRITE, LARGEST, fault, to_float
from workgauge.values.errors import SiteError

Element: TypeAlias = etree._Element

_HEAD_CHUNK = 65536
#: Far beyond any real prolog; a root element that starts later is not looked for.
_HEAD_LIMIT = 16 * _HEAD_CHUNK
ROOT = "LandXML"
#: Namespaces are known by these words in them; files without a namespace are accepted too.
_NAMESPACES = ("landxml", "inframodel")


def local(element: Element) -> str:
    """Return the local name of an element, without its namespace."""
    return str(element.tag).rpartition("}")[2]


class _Stop(Exception):  # noqa: N818 - ends the scan of the prolog, no error
    pass


def check_prolog(path: Path) -> None:
    """Refuse a file that is not XML, declares a document type, or whose root is not LandXML.

    Raises:
        SiteError: with file and line.
    """
    found: list[str] = []
    parser = expat.ParserCreate(namespace_separator=" ")

    def doctype(*_: object) -> None:
        raise SiteError(
            "document type declarations and entities are refused",
            file=path,
            line=parser.CurrentLineNumber,
            allowed="XML without <!DOCTYPE ...>",
        )

    def start(name: str, _: object) -> None:
        found.extend(name.rpartition(" ")[::2])
        raise _Stop

    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = start
    try:
        with path.open("rb") as stream:
            while not found:
                chunk = stream.read(_HEAD_CHUNK)
                parser.Parse(chunk, not chunk)
                if stream.tell() > _HEAD_LIMIT:
                    raise SiteError("not a LandXML file: no root element at its beginning", file=path)
                if not chunk:
                    break
    except _Stop:
        pass
    except expat.ExpatError as error:
        empty = error.code == expat.errors.codes[expat.errors.XML_ERROR_NO_ELEMENTS]
        text = (
            "the file is empty" if empty and path.stat().st_size == 0 else f"not XML: {expat.ErrorString(error.code)}"
        )
        raise SiteError(text, file=path, line=error.lineno) from error
    except (LookupError, ValueError) as error:
        raise SiteError("text in an unknown encoding", file=path, line=1, value=str(error)) from error
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    namespace, name = found or ("", "none")
    line = parser.CurrentLineNumber
    if name != ROOT:
        raise SiteError("wrong root element", file=path, line=line, value=name, allowed=ROOT)
    if namespace and not any(word in namespace.lower() for word in _NAMESPACES):
        raise SiteError(
            "wrong namespace", file=path, line=line, value=namespace, allowed="LandXML's, Inframodel's or none"
        )


@dataclass
class Document:
    """A parsed LandXML file and its notes.

    Attributes:
        root: the tree, without the points and faces of surfaces.
        points, faces: the numbers of each `Pnts` and `Faces` element.
        warnings: what was corrected or doubted so far, one line each.
    """

    path: Path
    root: Element
    points: dict[Element, NumberBlock] = field(default_factory=dict)
    faces: dict[Element, NumberBlock] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def warn(self, text: str, element: str | None = None, line: int | None = None) -> None:
        """Note a correction or doubt."""
        place = self.path.name if line is None else f"{self.path.name}:{line}"
        self.warnings.append(f"{place}: {element}: {text}" if element else f"{place}: {text}")

    def error(
        self, text: str, element: Element | str, *, value: object = None, allowed: str | None = None
    ) -> SiteError:
        """Return the error to raise about an element."""
        if isinstance(element, str):
            return SiteError(text, file=self.path, element=element, value=value, allowed=allowed)
        return SiteError(
            text, file=self.path, line=line_of(element), element=label(element), value=value, allowed=allowed
        )

    def number(self, element: Element, key: str) -> float | None:
        """Return an attribute as a number, None where it is absent or empty.

        Raises:
            SiteError: it is no finite number, or too large for any.
        """
        text = (element.get(key) or "").strip()
        if not text:
            return None
        try:
            value = to_float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{key} must be a finite number", element, value=text)
        if abs(value) > LARGEST:
            raise self.error(f"{key} is too large", element, value=text, allowed=f"at most {LARGEST:g} either way")
        return value

    def numbers(self, element: Element, counts: tuple[int, ...]) -> list[float]:
        """Return the numbers in an element's text, of any finite size.

        Raises:
            SiteError: their count is not one of `counts`, or one is no finite number.
        """
        words = (element.text or "").split()
        wanted = " or ".join(str(c) for c in counts)
        if len(words) not in counts:
            raise self.error(
                f"expected {wanted} numbers", element, value=" ".join(words) or "none", allowed=HOW_TO_WRITE
            )
        if fault(words) is not None:
            raise self.error(
                "coordinates must be finite numbers", element, value=" ".join(words), allowed=HOW_TO_WRITE
            )
        return [to_float(word) for word in words]


def label(element: Element) -> str:
    """Return how to call an element in a message: its local name and its name, id or station."""
    for key in ("name", "id", "staStart", "station"):
        value = element.get(key)
        if value:
            return f"{local(element)} {value.strip()!r}" if key == "name" else f"{local(element)} {key} {value}"
    return local(element)


def children(element: Element, *names: str) -> Iterator[Element]:
    """Yield the child elements with one of these local names, in order."""
    for child in element:
        if local(child) in names:
            yield child


def child(element: Element, name: str) -> Element | None:
    """Return the first child element of this local name, or None."""
    return next(children(element, name), None)


def descendants(element: Element, name: str) -> Iterator[Element]:
    """Yield all elements below with this local name, in document order."""
    return element.iter(f"{{*}}{name}")


def _broken(path: Path, error: etree.XMLSyntaxError, stream: Any) -> SiteError:
    """Return the error of XML that cannot be parsed to its end, by the first fault the parser noted."""
    noted = next(iter(stream.error_log), None)
    reason = noted.message if noted is not None else (error.msg or "syntax error").partition(", line")[0]
    line = noted.line if noted is not None else error.lineno
    return SiteError(f"broken or truncated XML: {' '.join(reason.split())}", file=path, line=line or None)


def open_document(path: Path) -> Document:
    """Parse a LandXML file.

    Raises:
        SiteError: not XML, truncated, with a document type, wrong root, or with points or faces that are no numbers.
    """
    check_prolog(path)
    blocks: dict[str, dict[Element, NumberBlock]] = {"P": {}, "F": {}}
    try:
        with path.open("rb") as source:
            root = _parse(path, source, blocks)
    except (OSError, LookupError, ValueError) as error:
        raise SiteError(f"cannot be read: {error}", file=path) from error
    for kind in blocks.values():
        for numbers in kind.values():
            numbers.close()
    return Document(path, root, blocks["P"], blocks["F"])


def _parse(path: Path, source: BinaryIO, blocks: dict[str, dict[Element, NumberBlock]]) -> Element:
    """Return the tree without the points and faces of surfaces, which go into `blocks`."""
    stream = etree.iterparse(
        source,
        events=("end",),
        tag=("{*}P", "{*}F"),
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        remove_comments=True,
        remove_pis=True,
        huge_tree=True,
    )
    parents = {"P": "Pnts", "F": "Faces"}
    parent: Element | None = None
    block: NumberBlock | None = None
    try:
        for _, element in stream:
            above = element.getparent()
            if above is not parent or block is None:
                name = local(element)
                if above is None or local(above) != parents[name]:
                    continue
                parent = above
                block = blocks[name].setdefault(above, NumberBlock(path, name))
            block.add(element)
            before = element.getprevious()
            if before is not None:
                above.remove(before)
    except etree.XMLSyntaxError as error:
        raise _broken(path, error, stream) from error
    root: Element = stream.root
    return root
