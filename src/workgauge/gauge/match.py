"""Which rule has which feature: conditions of the rule book against names, codes and groups of the site model."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TypeAlias

from workgauge.gauge.blocks import Patterns
from workgauge.gauge.rules import Match, Rule, RuleBook
from workgauge.site.alignment import Alignment
from workgauge.site.model import LineFeature, PointFeature, SurfaceModel
from workgauge.values.errors import RuleError

Feature: TypeAlias = Alignment | PointFeature | LineFeature | SurfaceModel


@dataclass(frozen=True, slots=True)
class Traits:
    """What conditions are judged by, the same for every kind of feature."""

    name: str
    codes: tuple[str, ...] = ()
    desc: str = ""
    groups: tuple[str, ...] = ()
    kind: str = ""
    properties: Mapping[str, str] = field(default_factory=dict)
    has_cant: bool | None = None
    has_profile: bool | None = None


def traits(feature: Feature) -> Traits:
    """Return what a feature is judged by."""
    desc = feature.desc or ""
    if isinstance(feature, Alignment):
        return Traits(
            feature.name,
            tuple(feature.codes.values()),
            desc,
            properties=feature.codes,
            has_cant=feature.has_cant,
            has_profile=feature.has_profile,
        )
    codes = () if feature.code is None else (feature.code,)
    if isinstance(feature, PointFeature):
        return Traits(feature.name, codes, desc, feature.groups, properties=feature.properties)
    if isinstance(feature, LineFeature):
        return Traits(feature.name, codes, desc, kind=feature.kind, properties=feature.properties)
    return Traits(feature.name, codes, desc, properties=feature.properties)


def matches(match: Match, given: Traits) -> bool:
    """Return whether every condition of `match` holds."""
    return (
        _some(match.name, (given.name,))
        and (match.name_regex is None or _compiled(match.name_regex).search(given.name) is not None)
        and _some(match.code, given.codes)
        and _some(match.desc, (given.desc,))
        and _some(match.group, given.groups)
        and _some(match.kind, (given.kind,))
        and (match.has_cant is None or given.has_cant is match.has_cant)
        and (match.has_profile is None or given.has_profile is match.has_profile)
        and (match.not_name is None or not _some(match.not_name, (given.name,)))
        and all(
            _some(p, [given.properties[key]] if key in given.properties else [])
            for key, p in (match.property or {}).items()
        )
        and (match.any_of is None or any(matches(inner, given) for inner in match.any_of))
    )


def rule_for(book: RuleBook, feature: Feature, surfaces: Sequence[SurfaceModel] = ()) -> Rule | None:
    """Return the first rule of the book that is for this feature, or None; `surfaces` are all those of the site."""
    given, kind = traits(feature), kind_of(feature)

    def has(rule: Rule) -> bool:
        if rule.feature != kind or not matches(rule.match, given):
            return False
        others = (traits(other) for other in surfaces if other is not feature)
        return rule.beside is None or any(matches(rule.beside, t) and not matches(rule.match, t) for t in others)

    return next((rule for rule in book.rules if has(rule)), None)


def kind_of(feature: Feature) -> str:
    """Return what a rule book calls this kind of feature: `alignment`, `point`, `line` or `surface`."""
    if isinstance(feature, Alignment):
        return "alignment"
    if isinstance(feature, PointFeature):
        return "point"
    return "line" if isinstance(feature, LineFeature) else "surface"


def _some(patterns: Patterns | None, texts: Iterable[str]) -> bool:
    if patterns is None:
        return True
    lowered = [text.strip().casefold() for text in texts]
    return any(fnmatchcase(text, pattern.casefold()) for text in lowered for pattern in patterns)


def _compiled(pattern: str) -> re.Pattern[str]:
    try:
        return re.compile(pattern)
    except re.error as error:
        raise RuleError(
            "not a regular expression", element="name_regex", value=pattern, allowed=f"Python's syntax ({error})"
        ) from error
