"""What a page and its server say to each other over their web socket: JSON, checked to the last field."""

import json
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from workgauge.values.errors import WireError
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp
from workgauge.values.station import Camera, Request, RequestKind

#: Nothing a page says is longer [bytes].
LONGEST = 4096

Text: TypeAlias = Annotated[str, Field(max_length=200)]
Number: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Lever: TypeAlias = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Count: TypeAlias = Annotated[int, Field(ge=0, lt=2**32)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Hands(_Part):
    """Where the hands are: `n` counts up; `seen` is the newest snapshot the page had when it said so."""

    say: Literal["hands"]
    n: Count
    seen: Count
    mode: Literal["joint", "tool", "exit", "auto"]
    levers: Annotated[list[Lever], Field(min_length=6, max_length=6)]
    enable: bool

    def intent(self, stamp: Stamp) -> Intent:
        """Return the operator's intent."""
        return Intent(stamp, DriveMode(self.mode), Levers(*self.levers), self.enable)


#: Requests that move nothing: they count however late they come.
ANY_TIME = frozenset({"stop", "take", "leave", "cancel"})


class Ask(_Part):
    """A request, as `values.station.Request`; `seen` is the newest snapshot the page had when it asked."""

    say: Literal["ask"]
    seen: Count
    id: Annotated[str, Field(min_length=1, max_length=40)]
    kind: Literal[
        "take", "give", "leave", "stop", "clear", "state", "guard", "play", "pause", "restart", "preview", "run",
        "cancel", "override",
    ]  # fmt: skip
    text: Text = ""
    reason: Text = ""
    number: Number | None = None
    on: bool | None = None
    numbers: Annotated[list[Number], Field(max_length=12)] = []
    settings: Annotated[dict[Annotated[str, Field(max_length=40)], Number], Field(max_length=6)] = {}

    def request(self, stamp: Stamp) -> Request:
        """Return the request."""
        return Request(
            *(stamp, self.id, RequestKind(self.kind), self.text, self.reason, self.number, self.on),
            *(tuple(self.numbers), tuple(self.settings.items())),
        )


class Seen(_Part):
    """The page has seen a snapshot."""

    say: Literal["seen"]
    n: Count

    def request(self, stamp: Stamp) -> Request:
        """Return the beat."""
        return Request(stamp, "", RequestKind.BEAT, number=float(self.n))


class Look(_Part):
    """How the page wants to look at the scene."""

    say: Literal["look"]
    view: Literal["overview", "top", "side", "cab", "follow"]
    dark: bool
    handle: bool

    def camera(self, stamp: Stamp, page: str) -> Camera:
        """Return the camera."""
        return Camera(stamp, page, self.view, self.dark, self.handle)


Said: TypeAlias = Hands | Ask | Seen | Look
_KINDS: dict[str, type[Said]] = {"hands": Hands, "ask": Ask, "seen": Seen, "look": Look}


def is_stop(text: str) -> bool:
    """Return whether a page asks for a stop."""
    try:
        said = heard(text)
    except WireError:
        return False
    return isinstance(said, Ask) and said.kind == "stop"


def heard(text: str | bytes) -> Said:
    """Return what a page said.

    Raises:
        WireError: for anything else.
    """
    if len(text) > LONGEST:
        raise WireError("too long", element="message", value=len(text), allowed=f"{LONGEST} bytes")
    try:
        given = json.loads(text)
        kind = _KINDS[given["say"]]
        return kind.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise WireError(first["msg"], element=".".join(map(str, first["loc"])) or "message") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise WireError("not something a page says", element="message") from None
