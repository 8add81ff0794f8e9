"""Guards by name. A new guard is one file, one test and one line here."""

from collections.abc import Callable

from workgauge.guard.api import Guard
from workgauge.guard.barrier import BarrierGuard
from workgauge.guard.free import NoGuard
from workgauge.guard.linear import LinearGuard
from workgauge.guard.potential import PotentialGuard
from workgauge.values.errors import InputError

#: Name to a guard with its own defaults.
GUARDS: dict[str, Callable[[], Guard]] = {
    "barrier": BarrierGuard,
    "linear": LinearGuard,
    "none": NoGuard,
    "potential": PotentialGuard,
}


def guard_named(name: str) -> Guard:
    """Return the guard of that name with its own defaults.

    Raises:
        InputError: if there is none, naming those there are.
    """
    try:
        return GUARDS[name]()
    except KeyError:
        raise InputError("unknown guard", element="guard", value=name, allowed=", ".join(sorted(GUARDS))) from None
