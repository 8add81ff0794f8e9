"""Reading a rule book: YAML with line numbers, validated; complaints name file, line, key and what is allowed."""

import copy
import functools
from collections.abc import Hashable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from workgauge.gauge.blocks import Sourced
from workgauge.gauge.rules import RuleBook
from workgauge.values.errors import RuleError

#: A rule book larger than this, or with more nodes than this once aliases are followed, is refused.
LARGEST_BYTES = 2_000_000
MOST_NODES = 200_000


def shipped_names() -> tuple[str, ...]:
    """Return the names of the rule books that come with the program."""
    folder = resources.files("workgauge") / "shipped" / "rules"
    return tuple(sorted(p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")))


def load_rule_book(name_or_path: str | Path) -> RuleBook:
    """Read and validate a rule book.

    Args:
        name_or_path: a shipped name (`finland`, `germany`, `generic`) or a YAML file.

    Raises:
        RuleError: unknown name, unreadable file, unknown key or bad value, with file, line, key and what is allowed.
    """
    name = str(name_or_path)
    if name in shipped_names():
        text = (resources.files("workgauge") / "shipped" / "rules" / f"{name}.yaml").read_text(encoding="utf-8")
        return parse_rule_book(text, f"{name}.yaml")
    path = Path(name_or_path)
    try:
        if path.is_dir() or not path.exists():
            raise RuleError(
                "no such rule book", file=name, allowed="a YAML file, or one of " + ", ".join(shipped_names())
            )
        if path.stat().st_size > LARGEST_BYTES:
            raise RuleError("the rule book is too large", file=name, allowed=f"at most {LARGEST_BYTES} bytes")
        text = path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise RuleError(f"the rule book cannot be read: {error}", file=name, allowed="UTF-8 YAML") from error
    return parse_rule_book(text, name)


def parse_rule_book(text: str, file: str) -> RuleBook:
    """Validate the text of a rule book; `file` is what complaints call it. Raises RuleError."""
    root, data = _compose(text, file)
    if not isinstance(data, dict):
        raise RuleError("a rule book is a mapping of keys", file=file, line=1, allowed="version, name, title, rules…")
    try:
        return RuleBook.model_validate(data)
    except ValidationError as error:
        raise _translated(error, root, data, file) from error


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of rule books."""
    return RuleBook.model_json_schema()


def sources(book: RuleBook) -> list[dict[str, str]]:
    """Return every stated source as {"key", "certainty", "source"}, in the book's order."""
    return [
        {"key": key, "certainty": block.certainty or "", "source": block.source or ""}
        for key, block in _blocks(book, "")
        if block.source or block.certainty
    ]


def unsourced(book: RuleBook) -> list[str]:
    """Return the keys of blocks that carry numbers and name no source."""
    return [
        key
        for key, block in _blocks(book, "")
        if not block.source and any(_numeric(value) for name, value in block if name in block.model_fields_set)
    ]


def _numeric(value: object) -> bool:
    """Return whether a value is a number or holds one that no sourced block of its own answers for."""
    if isinstance(value, tuple):
        return any(_numeric(inner) for inner in value)
    if isinstance(value, BaseModel) and not isinstance(value, Sourced):
        return any(_numeric(inner) for _, inner in value)
    return isinstance(value, float)


def _blocks(value: object, key: str) -> Iterator[tuple[str, Sourced]]:
    """Walk a book and yield every sourced block with the place it stands at."""
    if isinstance(value, BaseModel):
        if isinstance(value, Sourced):
            yield key or "book", value
        for name, inner in value:
            yield from _blocks(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, tuple):
        for i, inner in enumerate(value):
            label = getattr(inner, "name", None) if "rules" in key.rsplit(".", 1)[-1] else None
            yield from _blocks(inner, f"{key}[{label or i}]")
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _blocks(inner, f"{key}.{name}")


def _compose(text: str, file: str) -> tuple[yaml.Node | None, object]:
    """Parse YAML twice over one tree: nodes with their lines, and plain data. Duplicate keys are refused."""
    root, data = _parsed(text, file)
    return root, copy.deepcopy(data)


@functools.lru_cache(maxsize=16)
def _parsed(text: str, file: str) -> tuple[yaml.Node | None, object]:
    """Return what `_compose` does, not to be changed: the same text has the same."""
    loader = yaml.SafeLoader(text)
    try:
        root = loader.get_single_node()
        if root is not None:
            _count(root, {}, [], file)
        return root, None if root is None else loader.construct_document(root)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = None if mark is None else mark.line + 1
        raise RuleError(f"not valid YAML: {problem}", file=file, line=line, allowed="a YAML mapping") from error
    except (ValueError, RecursionError) as error:
        raise RuleError(f"not valid YAML: {error}", file=file, allowed="a YAML mapping") from error
    finally:
        loader.dispose()


def _count(node: yaml.Node, known: dict[int, int], above: list[int], file: str) -> int:
    """Return how many nodes a tree has with aliases followed; refuse loops, bombs and keys given twice."""
    if id(node) in known:
        return known[id(node)]
    if id(node) in above or len(above) > 50:
        raise RuleError("nested too deep, or an alias inside itself", file=file, line=node.start_mark.line + 1)
    total, inside = 1, [*above, id(node)]
    if isinstance(node, yaml.MappingNode):
        seen: set[Hashable] = set()
        for key, value in node.value:
            name = key.value if isinstance(key, yaml.ScalarNode) else id(key)
            if name in seen:
                raise RuleError("the same key twice", file=file, line=key.start_mark.line + 1, element=str(name))
            seen.add(name)
            total += _count(key, known, inside, file) + _count(value, known, inside, file)
    elif isinstance(node, yaml.SequenceNode):
        total += sum(_count(item, known, inside, file) for item in node.value)
    if total > MOST_NODES:
        raise RuleError("too many values", file=file, line=node.start_mark.line + 1, allowed=f"up to {MOST_NODES}")
    known[id(node)] = total
    return total


def _translated(error: ValidationError, root: yaml.Node | None, data: object, file: str) -> RuleError:
    """Turn the first complaint of pydantic into one of ours."""
    first = error.errors(include_url=False)[0]
    place = _path(first["loc"], data)
    line = _line(root, place)
    element = ".".join(str(p) for p in place) or "rule book"
    kind, message = first["type"], first["msg"].removeprefix("Value error, ")
    if kind == "extra_forbidden":
        known = sorted(_known_keys(place[:-1], data))
        return RuleError(
            "unknown key", file=file, line=line, element=element, value=place[-1], allowed=", ".join(known) or None
        )
    if kind == "missing":
        return RuleError("a key is missing", file=file, line=line, element=element)
    value = first["input"]
    shown = None if isinstance(value, dict) and kind == "value_error" else value
    allowed = message.removeprefix("Input should be ")
    return RuleError("bad value", file=file, line=line, element=element, value=shown, allowed=allowed)


def _path(loc: tuple[int | str, ...], data: object) -> list[int | str]:
    """Return the part of pydantic's location that stands in the data; union tags it inserts are dropped."""
    place: list[int | str] = []
    for i, step in enumerate(loc):
        last = i == len(loc) - 1
        if isinstance(data, dict):
            if step in data:
                place.append(step)
                data = data[step]
            elif last and not _is_tag(step, data):
                place.append(step)
        elif isinstance(data, list | tuple) and isinstance(step, int) and step < len(data):
            place.append(step)
            data = data[step]
    return place


def _is_tag(step: int | str, data: dict[Any, Any]) -> bool:
    """Return whether a step of a location only names the chosen variant of a union."""
    return step in (data.get("make"), data.get("kind"))


def _line(node: yaml.Node | None, place: list[int | str]) -> int | None:
    """Return the line of a place in the YAML tree, as deep as it goes, counted from 1."""
    line = None
    for step in place:
        found: yaml.Node | None = None
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if getattr(key, "value", None) == str(step):
                    line, found = key.start_mark.line + 1, value
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            found = node.value[step]
            line = found.start_mark.line + 1
        if found is None:
            break
        node = found
    return line


def _known_keys(place: list[int | str], data: object) -> set[str]:
    """Return the keys allowed in the block at a place, by walking the JSON Schema beside the data."""
    schema = json_schema()
    definitions: dict[str, Any] = schema.get("$defs", {})
    options: list[dict[str, Any]] = [schema]
    for step in [*place, None]:
        options = [leaf for option in options for leaf in _resolved(option, definitions, data)]
        if step is None:
            break
        following: list[dict[str, Any]] = []
        for option in options:
            if isinstance(step, int):
                following += [option["items"]] if isinstance(option.get("items"), dict) else []
            elif step in option.get("properties", {}):
                following.append(option["properties"][step])
            elif isinstance(option.get("additionalProperties"), dict):
                following.append(option["additionalProperties"])
        data = data[step] if isinstance(data, dict | list) else None  # type: ignore[index]
        options = following
    return {key for option in options for key in option.get("properties", {})}


def _resolved(option: dict[str, Any], definitions: dict[str, Any], data: object) -> list[dict[str, Any]]:
    """Follow references and unions of a schema, keeping the variant the data's own tag chooses."""
    if "$ref" in option:
        return _resolved(definitions[option["$ref"].rsplit("/", 1)[-1]], definitions, data)
    tag = option.get("discriminator")
    if tag is not None and isinstance(data, dict):
        chosen = tag["mapping"].get(data.get(tag["propertyName"]))
        return [] if chosen is None else _resolved({"$ref": chosen}, definitions, data)
    variants = option.get("anyOf") or option.get("oneOf") or option.get("allOf")
    if variants:
        return [leaf for variant in variants for leaf in _resolved(variant, definitions, data)]
    return [option]
