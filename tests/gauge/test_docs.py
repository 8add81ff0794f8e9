"""The rule books page: its examples load and run, and it names every key there is."""

import doctest
import math
import re
from pathlib import Path

import pytest
import yaml

from workgauge.gauge.build import build_limits
from workgauge.gauge.rulebook import json_schema, parse_rule_book, unsourced
from workgauge.gauge.rules import MAKES

PAGE = Path(__file__).parents[2] / "docs" / "rule-books.md"
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)


def test_the_python_examples_run():
    failed, tried = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert tried >= 10 and not failed


def test_the_example_book_makes_what_the_page_says(make):
    book = parse_rule_book(BLOCKS[0], "rule-books.md")
    assert unsourced(book) == []
    ground = make.surface(
        "Ground", [[-90, -90, 80], [90, -90, 80], [-90, 90, 80], [90, 90, 80]], [[0, 1, 2], [1, 3, 2]]
    )
    site = make.site(
        make.alignment([(60.0, 0, 0)], name="Siding 3"),
        make.line("Contact wire", [[0, 0, math.nan], [60, 0, math.nan]]),
        make.point("L1", 4, 4, math.nan, code="lamp"),
        make.point("nail", 5, 5, 80.0),
        ground,
    )
    limits = build_limits(site, book)
    assert [limit.name for limit in limits.limits] == ["Siding 3", "Contact wire", "Lamp L1", "Ground", "Shaft"]
    assert limits.limits[0].activity.state == "Siding 3 open to traffic"
    assert "rule 'other-points' leaves out 1 feature: 'nail'" in limits.warnings


FRAME = """\
version: 1
name: mine
title: t
profiles: {G2: {half_width_at_height_m: [[1.6, 0.4], [1.2, 4.0]]}}
voltages: {"25 kV": {below_m: 1.0, side_m: 3.0}}
"""


@pytest.mark.parametrize("block", BLOCKS[1:], ids=range(1, len(BLOCKS)))
def test_every_other_example_is_part_of_a_book(block):
    data = yaml.safe_load(block)
    if "limits" in data:
        (feature,) = (kind for kind, makes in MAKES.items() if {limit["make"] for limit in data["limits"]} <= makes)
        data = {"rules": [{"name": "r", "feature": feature, "limits": data["limits"]}]}
    assert parse_rule_book(FRAME + yaml.safe_dump(data), "rule-books.md")


def test_every_key_and_every_kind_of_limit_is_on_the_page():
    text = PAGE.read_text(encoding="utf-8")
    schema = json_schema()
    keys = {key for part in (schema, *schema["$defs"].values()) for key in part.get("properties", {})}
    assert len(keys) > 60
    assert [key for key in sorted(keys) if not re.search(rf"\b{key}\b", text)] == []
    assert [kind for kinds in MAKES.values() for kind in kinds if f"make: {kind}" not in text] == []
