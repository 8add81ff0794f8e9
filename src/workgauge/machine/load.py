"""Machine files and the shipped catalogue; every fault becomes one `MachineError` with file, line, key and value."""

import copy
import difflib
import functools
from collections.abc import Hashable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from workgauge.machine.build import build
from workgauge.machine.description import MachineDescription
from workgauge.machine.faults import DescriptionError, Place
from workgauge.machine.model import MachineModel
from workgauge.values.errors import MachineError

_SUFFIXES = (".yaml", ".yml")
_LARGEST = 1_000_000  # bytes; a description is a few kilobytes


def catalogue() -> tuple[str, ...]:
    """Return the names of the shipped machines."""
    folder = resources.files("workgauge") / "shipped" / "machines"
    return tuple(sorted(Path(file.name).stem for file in folder.iterdir() if file.name.endswith(_SUFFIXES)))


def description_path(name_or_path: str | Path) -> Path:
    """Return the file of a machine: a shipped one by its name, any other by its path.

    Raises:
        MachineError: if there is no shipped machine of that name.
    """
    text = str(name_or_path)
    if text in catalogue():
        return Path(str(resources.files("workgauge") / "shipped" / "machines" / f"{text}.yaml"))
    if isinstance(name_or_path, Path) or text.endswith(_SUFFIXES) or "/" in text or "\\" in text:
        return Path(name_or_path)
    near = difflib.get_close_matches(text, catalogue(), 1)
    hint = f", did you mean {near[0]}?" if near else ""
    allowed = f"{', '.join(catalogue())}, or a path to a .yaml file"
    raise MachineError(f"unknown machine{hint}", value=text, allowed=allowed)


def read_description(name_or_path: str | Path) -> tuple[Path, dict[str, Any]]:
    """Return a machine's file and the mapping in it, not yet judged.

    Raises:
        MachineError: if there is no such file, or it holds no mapping.
    """
    path = description_path(name_or_path)
    content, _ = _read_yaml(path)
    return path, content


def load_machine(name_or_path: str | Path, attachment: str | None = None) -> MachineModel:
    """Return a machine from the catalogue by name, or from a YAML file by path.

    Args:
        name_or_path: a shipped name (`rre20`), or a path: anything with a folder in it or ending in .yaml, .yml.
        attachment: the attachment to mount; the description's first if None.

    Raises:
        MachineError: if there is no such machine or attachment, or the description is not valid.
    """
    path = description_path(name_or_path)
    content, lines = _read_yaml(path)
    return _make(path.stem, content, path.parent, attachment, path, lines)


def machine_from(
    content: Mapping[str, Any], name: str = "machine", folder: Path | None = None, attachment: str | None = None
) -> MachineModel:
    """Return a machine from a description that is already in memory (the YAML file's mapping).

    Raises:
        MachineError: as `load_machine`.
    """
    return _make(name, content, folder or Path(), attachment, None, {})


def _make(
    name: str, content: Any, folder: Path, attachment: str | None, path: Path | None, lines: dict[Place, int]
) -> MachineModel:
    try:
        description = MachineDescription.model_validate(content)
        return build(name, description, folder, attachment)
    except ValidationError as error:
        refused = _from_pydantic(error)
    except DescriptionError as error:
        refused = error
    raise MachineError(
        refused.message,
        file=path,
        line=_line(lines, refused.place),
        element=_element(content, refused.place),
        value=refused.value,
        allowed=refused.allowed,
    )


def _from_pydantic(error: ValidationError) -> DescriptionError:
    """Return the first fault pydantic found, in our words."""
    fault = error.errors(include_url=False)[0]
    place = tuple(part for part in fault["loc"] if part not in ("revolute", "prismatic"))
    context = fault.get("ctx", {})
    value = fault["input"]
    match fault["type"]:
        case "refused":
            if context["key"] is not None:
                place = (*place, context["key"])
            return DescriptionError(place, context["message"], context["value"], context["allowed"])
        case "missing":
            return DescriptionError(place, "missing key")
        case "union_tag_not_found":
            return DescriptionError((*place, "type"), "missing key", allowed="revolute, prismatic")
        case "union_tag_invalid":
            return DescriptionError((*place, "type"), "unknown kind of joint", context["tag"], "revolute, prismatic")
        case "greater_than":
            return DescriptionError(place, "too small", value, f"above {context['gt']:g}")
        case "greater_than_equal":
            return DescriptionError(place, "too small", value, f"{context['ge']:g} or more")
        case "less_than":
            return DescriptionError(place, "too large", value, f"below {context['lt']:g}")
        case "less_than_equal":
            return DescriptionError(place, "too large", value, f"{context['le']:g} or less")
        case "finite_number":
            return DescriptionError(place, "not a finite number", value, "a finite number")
        case "literal_error":
            return DescriptionError(place, "unknown value", value, context["expected"])
    message = fault["msg"][:1].lower() + fault["msg"][1:]
    return DescriptionError(place, message, value if not isinstance(value, (dict, list)) else None)


def _element(content: Any, place: Place) -> str | None:
    """Return a place as people read it: list items by their name where they have one, `joints[boom].lower_deg`."""
    text, node = "", content
    for part in place:
        if isinstance(part, int):
            item = node[part] if isinstance(node, (list, tuple)) and part < len(node) else None
            label = item.get("name") if isinstance(item, dict) else None
            text += f"[{label if isinstance(label, str) else part}]"
            node = item
        else:
            text += f".{part}" if text else part
            node = node.get(part) if isinstance(node, dict) else None
    return text or None


def _line(lines: dict[Place, int], place: Place) -> int | None:
    """Return the line of a place, or of the nearest thing around it that has one."""
    for end in range(len(place), -1, -1):
        if place[:end] in lines:
            return lines[place[:end]]
    return None


class _PlainLoader(yaml.SafeLoader):
    """YAML without aliases and without repeated keys."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.get_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(None, None, "aliases are not read here", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                raise yaml.MarkedYAMLError(None, None, f"key {key.value} appears twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _read_yaml(path: Path) -> tuple[dict[str, Any], dict[Place, int]]:
    """Return a file's content and the line of every key and list item in it."""
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise MachineError("cannot read the machine description", file=path, value=reason) from error
    if len(data) > _LARGEST:
        raise MachineError("this is no machine description", file=path, value=f"{len(data)} bytes", allowed="1 MB")
    try:
        node, content = _parsed(data)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise MachineError(f"bad YAML: {error.problem}", file=path, line=line) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise MachineError(f"bad YAML: {str(error).splitlines()[0]}", file=path) from error
    if not isinstance(content, dict):
        found = "nothing" if content is None else type(content).__name__
        raise MachineError("this is no machine description", file=path, value=found, allowed="a mapping of keys")
    lines: dict[Place, int] = {}
    _collect_lines(node, (), lines)
    return copy.deepcopy(content), lines


@functools.lru_cache(maxsize=16)
def _parsed(data: bytes) -> tuple[yaml.Node | None, Any]:
    """Return the nodes and the content of YAML; neither is to be changed, the same bytes have the same."""
    loader = _PlainLoader(data)
    node = loader.get_single_node()
    return node, None if node is None else loader.construct_document(node)


def _collect_lines(node: yaml.Node | None, place: Place, lines: dict[Place, int]) -> None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            lines[(*place, key.value)] = key.start_mark.line + 1
            _collect_lines(value, (*place, key.value), lines)
    elif isinstance(node, yaml.SequenceNode):
        for i, value in enumerate(node.value):
            lines[(*place, i)] = value.start_mark.line + 1
            _collect_lines(value, (*place, i), lines)
