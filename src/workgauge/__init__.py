"""workgauge keeps every part of a heavy manipulator inside a working gauge computed from the site's own model.

The public interface is `Session`: a site, a machine, a rule book and a guard, advanced one tick at a time by
`Session.step()`. The command line is a thin shell around it.
"""

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from workgauge.rehearse.session import Session

__version__ = version("workgauge")
__all__ = ["Session", "__version__"]


def __getattr__(name: str) -> Any:
    """Load `Session` on first use, so that `import workgauge` stays light."""
    if name == "Session":
        from workgauge.rehearse.session import Session

        return Session
    raise AttributeError(f"module 'workgauge' has no attribute {name!r}")
