"""Site files in, one site model out. A new format is one reader and one line in `READERS`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.site.coordinates import resolve_crs
from workgauge.site.landxml.reader import looks_like_landxml, read_landxml
from workgauge.site.model import SiteModel
from workgauge.values.errors import SiteError

_HEAD_BYTES = 4096


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


READERS: tuple[Reader, ...] = (Reader("LandXML/Inframodel (.xml)", looks_like_landxml, read_landxml),)


def read_site(files: Sequence[Path], *, epsg: int | None = None) -> SiteModel:
    """Read site files and merge them.

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
    for path in (Path(f) for f in files):
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
    return _merge(models, known, without)


def _read_one(path: Path) -> SiteModel:
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except FileNotFoundError:
        raise SiteError("no such file", file=path) from None
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    for reader in READERS:
        if reader.accepts(path, head):
            return reader.read(path)
    raise SiteError("unknown kind of site file", file=path, allowed=", ".join(r.name for r in READERS))


def _merge(models: list[SiteModel], known: dict[str, ProjectedCrs], without: list[str]) -> SiteModel:
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
    warnings = [w for m in models for w in m.warnings]
    if first is not None:
        warnings += [
            f"{name}: taken to be in EPSG:{first.epsg} ({first.name}) like the other files" for name in without
        ]
    alignments = tuple(a for m in models for a in m.alignments)
    names = [a.name for a in alignments]
    warnings += [f"several alignments are called {name!r}" for name in sorted(set(names)) if names.count(name) > 1]
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
