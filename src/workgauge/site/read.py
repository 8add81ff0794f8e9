"""Site files in, one site model out. A new format is one reader and one line in `READERS`."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.site.alignment import Alignment
from workgauge.site.coordinates import resolve_crs
from workgauge.site.dxf import looks_like_dxf, read_dxf
from workgauge.site.landxml.reader import looks_like_landxml, read_landxml
from workgauge.site.model import SiteModel
from workgauge.site.text_file import refuse_wide
from workgauge.site.xyz import looks_like_xyz, read_xyz
from workgauge.values.errors import SiteError

_HEAD_BYTES = 4096


#: First bytes of files that are refused by name, whatever their suffix.
_OTHERS: tuple[tuple[bytes, str], ...] = (
    (b"\x1f\x8b", "is compressed (gzip); unpack it first"),
    (b"PK\x03\x04", "is compressed (zip); unpack it first"),
    (b"BZh", "is compressed (bzip2); unpack it first"),
    (b"\xfd7zXZ\x00", "is compressed (xz); unpack it first"),
    (b"7z\xbc\xaf\x27\x1c", "is compressed (7z); unpack it first"),
    (b"ISO-10303-21", "is an IFC or other STEP file, which is not read"),
    (b"%PDF", "is a PDF file, which is not read"),
)


@dataclass(frozen=True, slots=True)
class Reader:
    """One file format.

    Attributes:
        name: what to call it.
        accepts: whether a file is of this format, by its path and first bytes.
        read: the file as a site model whose coordinate system is declared but not resolved.
    """

    name: str
    accepts: Callable[[Path, bytes], bool]
    read: Callable[[Path], SiteModel]


READERS: tuple[Reader, ...] = (
    Reader("LandXML/Inframodel (.xml)", looks_like_landxml, read_landxml),
    Reader("3DFACEs of DXF (.dxf)", looks_like_dxf, read_dxf),
    Reader("points, a line each: east north height (.xyz, .txt, .csv, .pts)", looks_like_xyz, read_xyz),
)


def read_site(files: Sequence[Path], *, epsg: int | None = None) -> SiteModel:
    """Read site files and merge them. A file given twice, or a copy of one, is read once, with a warning.

    Args:
        files: at least one.
        epsg: coordinate system to use instead of the one the files state.

    Raises:
        SiteError: a file is missing, of an unknown kind or not readable, or files have different coordinate systems.
        GeodesyError: an unknown coordinate system, or coordinates outside its area.
    """
    if not files:
        raise SiteError("no site file given")
    models: list[SiteModel] = []
    known: dict[str, ProjectedCrs] = {}
    without: list[str] = []
    paths, repeated = _each_once([Path(f) for f in files])
    for path in paths:
        model = _read_one(path)
        resolved = resolve_crs(model, str(path), path.name, epsg)
        if resolved.crs is None:
            without.append(path.name)
        else:
            known[str(path)] = resolved.crs
        models.append(
            SiteModel(
                crs=resolved.crs,
                crs_declared=model.crs_declared,
                units=model.units,
                alignments=model.alignments,
                surfaces=model.surfaces,
                points=model.points,
                lines=model.lines,
                warnings=(*model.warnings, *resolved.warnings),
                files=model.files,
            )
        )
    return _merge(models, known, without, repeated)


def _each_once(paths: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Return the files without repetitions, and a warning for each file that is given again or copied.

    Raises:
        SiteError: a file is missing or not readable.
    """
    kept: list[Path] = []
    resolved_before: set[Path] = set()
    first_of: dict[str, Path] = {}
    warnings: dict[str, None] = {}
    for path in paths:
        try:
            with path.open("rb") as stream:
                content = hashlib.file_digest(stream, "sha256").hexdigest()
            resolved = path.resolve()
        except FileNotFoundError:
            raise SiteError("no such file", file=path) from None
        except (OSError, RuntimeError) as error:
            reason = error.strerror if isinstance(error, OSError) else None
            raise SiteError(f"cannot be read: {reason or error}", file=path) from error
        if resolved in resolved_before:
            warnings[f"{path.name}: given twice, read once"] = None
        elif content in first_of:
            warnings[f"{path.name}: given twice, read once; its content is that of {first_of[content]}"] = None
        else:
            first_of[content] = path
            kept.append(path)
        resolved_before.add(resolved)
    return kept, list(warnings)


def _named_apart(alignments: Sequence[Alignment], warnings: list[str]) -> tuple[Alignment, ...]:
    """Return the alignments with names of their own: the second `A` becomes `A (2)`, so that it can be reached."""
    taken = {a.name for a in alignments}
    seen: set[str] = set()
    out: list[Alignment] = []
    for alignment in alignments:
        name = alignment.name
        if name in seen:
            number = 2
            while f"{name} ({number})" in taken:
                number += 1
            alignment = alignment.renamed(f"{name} ({number})")
            taken.add(alignment.name)
            place = f"{alignment.source.file}:{alignment.source.line}"
            warnings.append(f"{place}: several alignments are called {name!r}; this one becomes {alignment.name!r}")
        seen.add(name)
        out.append(alignment)
    return tuple(out)


def _read_one(path: Path) -> SiteModel:
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except FileNotFoundError:
        raise SiteError("no such file", file=path) from None
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    for start, text in _OTHERS:
        if head.startswith(start):
            raise SiteError(text, file=path, allowed=", ".join(r.name for r in READERS))
    for reader in READERS:
        if reader.accepts(path, head):
            return reader.read(path)
    refuse_wide(path, head)
    raise SiteError("unknown kind of site file", file=path, allowed=", ".join(r.name for r in READERS))


def _merge(
    models: list[SiteModel], known: dict[str, ProjectedCrs], without: list[str], repeated: list[str]
) -> SiteModel:
    first_file, first = next(iter(known.items()), ("", None))
    for file, crs in known.items():
        same = first is None or (crs == first if None in (crs.epsg, first.epsg) else crs.epsg == first.epsg)
        if first is not None and not same:
            raise SiteError(
                "site files with different coordinate systems",
                file=file,
                value=f"EPSG:{crs.epsg} ({crs.name})",
                allowed=f"EPSG:{first.epsg} ({first.name}) as in {first_file}",
            )
    warnings = [*repeated, *(w for m in models for w in m.warnings)]
    if first is not None:
        warnings += [
            f"{name}: taken to be in EPSG:{first.epsg} ({first.name}) like the other files" for name in without
        ]
    alignments = _named_apart([a for m in models for a in m.alignments], warnings)
    units: dict[str, str] = {}
    for key in dict.fromkeys(k for m in models for k in m.units):
        units[key] = ", ".join(dict.fromkeys(m.units[key] for m in models if key in m.units))
    return SiteModel(
        crs=first,
        crs_declared=next((m.crs_declared for m in models if m.crs_declared), {}),
        units=units,
        alignments=alignments,
        surfaces=tuple(s for m in models for s in m.surfaces),
        points=tuple(p for m in models for p in m.points),
        lines=tuple(line for m in models for line in m.lines),
        warnings=tuple(warnings),
        files=tuple(f for m in models for f in m.files),
    )
