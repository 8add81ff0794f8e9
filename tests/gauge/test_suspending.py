"""Limits a supervisor may suspend: those the rule book names, each by itself, and nothing a work state switches."""

from dataclasses import fields, replace

import pytest
import yaml

from workgauge.gauge.build import build_limits
from workgauge.gauge.rulebook import load_rule_book, parse_rule_book
from workgauge.gauge.rules import MaySuspend
from workgauge.gauge.suspending import IN_FORCE, may_suspend, suspendable
from workgauge.rehearse.shipped import shipped_path, shipped_site_files
from workgauge.site.read import read_site
from workgauge.values.errors import RuleError


@pytest.fixture(scope="module")
def built():
    rules = load_rule_book("finland")
    return rules, build_limits(read_site(shipped_site_files("double_track")), rules).limits


def allowing(rules, *names: str):
    return rules.model_copy(update={"may_suspend": tuple(MaySuspend(rule=name, at_most_min=10.0) for name in names)})


def test_the_shipped_books_allow_none(built) -> None:
    rules, limits = built
    assert suspendable(limits, rules) == limits
    assert may_suspend(limits, rules) == {}


def test_each_limit_of_a_named_rule_by_itself(built) -> None:
    rules, limits = allowing(built[0], "catenary-pole"), built[1]
    found = suspendable(limits, rules)
    poles = [one.id for one in limits if one.rule == "catenary-pole"]
    assert poles and may_suspend(found, rules) == {name: (IN_FORCE + name, 10.0) for name in poles}
    for before, after in zip(limits, found, strict=True):
        name = after.id
        assert (after.activity.state == IN_FORCE + name) == (name in poles)
        others = (field.name for field in fields(before) if field.name != "activity")
        assert all(getattr(after, field) is getattr(before, field) for field in others)
        if name in poles:
            assert replace(after.activity, state=None) == before.activity


def test_what_a_work_state_switches_is_never_suspended(built) -> None:
    rules, limits = allowing(built[0], "track"), built[1]
    switched = [one for one in limits if one.rule == "track"]
    assert switched and all(one.activity.state for one in switched)
    assert may_suspend(suspendable(limits, rules), rules) == {}


@pytest.mark.parametrize("entry", [{"rule": "no-such-rule", "at_most_min": 10}, {"rule": "track", "at_most_min": 0}])
def test_names_and_minutes_that_cannot_be_are_refused(entry: dict[str, object]) -> None:
    data = yaml.safe_load(shipped_path("rules", "finland.yaml").read_text()) | {"may_suspend": [entry]}
    with pytest.raises(RuleError) as refused:
        parse_rule_book(yaml.safe_dump(data), "mine.yaml")
    assert "may_suspend" in str(refused.value)
