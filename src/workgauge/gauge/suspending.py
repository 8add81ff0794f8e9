"""Limits that a supervisor may suspend: where the rule book allows it, each is in force by a state of its own."""

from collections.abc import Iterable
from dataclasses import replace

from workgauge.gauge.rules import RuleBook
from workgauge.values.limits import Activity, Limit

#: Begins the states of limits that may be suspended; no work state of a rule book is named so.
IN_FORCE = "in force: "


def suspendable(limits: Iterable[Limit], rules: RuleBook) -> tuple[Limit, ...]:
    """Return the limits, those that may be suspended in force by a state of their own; all others as they are.

    A limit with a work state is switched by that, and never suspended.
    """
    allowed = {one.rule for one in rules.may_suspend}
    return tuple(
        replace(one, activity=_by_itself(one)) if one.rule in allowed and one.activity.state is None else one
        for one in limits
    )


def may_suspend(limits: Iterable[Limit], rules: RuleBook) -> dict[str, tuple[str, float]]:
    """Return the ids of limits that may be suspended, each with its state and for how many minutes at most."""
    minutes = {one.rule: one.at_most_min for one in rules.may_suspend}
    return {
        one.id: (one.activity.state, minutes[one.rule])
        for one in limits
        if one.rule in minutes and one.activity.state == IN_FORCE + one.id
    }


def _by_itself(limit: Limit) -> Activity:
    return replace(limit.activity, state=IN_FORCE + limit.id)
