"""What the page's server knows of the machine, and what it passes on to it; one task reads the mail for all pages."""

import asyncio
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from workgauge.values.errors import WireError
from workgauge.values.mail import Inbox, Mail
from workgauge.values.measurements import Intent, Stamp
from workgauge.values.station import Camera, Handle, PreviewResult, Request, Setup, Snapshot
from workgauge.wire.messages import encode
from workgauge.wire.station import as_json, decode_station, encode_station, topic

#: The mail is looked at so often [s].
LOOK_S = 0.004
#: Pages are told no more often than this what was refused [s].
TELL_S = 0.5
#: So many snapshots are remembered, to tell how old what a page has seen is.
REMEMBERED = 256
#: Topics read.
_READ = ("snapshot", "setup", "preview-result", "handle")


@dataclass(eq=False, slots=True)
class Post:
    """What waits for one page: the newest of each kind, so that a slow page costs nobody anything."""

    waiting: dict[str, str] = field(default_factory=dict)
    ready: asyncio.Event = field(default_factory=asyncio.Event)

    def put(self, kind: str, text: str) -> None:
        """Replace what waits of a kind."""
        self.waiting[kind] = text
        self.ready.set()

    async def next(self) -> list[str]:
        """Wait for something, and return all that waits."""
        await self.ready.wait()
        self.ready.clear()
        found, self.waiting = list(self.waiting.values()), {}
        return found


class Hub:
    """Between the mail and the pages.

    Args:
        mail: the connection to the machine. machine_id: which one. clock: monotonic [ns].
    """

    def __init__(self, mail: Mail, machine_id: str, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._mail, self.machine_id, self._clock = mail, machine_id, clock
        self._inboxes: dict[str, Inbox] = {
            name: mail.inbox(topic(machine_id, name), 8 if name == "snapshot" else 2) for name in _READ
        }
        self._newest: dict[str, str] = {}
        self._seen_ns: dict[int, int] = {}
        self.posts: set[Post] = set()
        self.setup: Setup | None = None
        self.refused: Counter[str] = Counter()  #: what pages said and was not passed on, by cause
        self._told: Counter[str] = Counter()
        self._told_ns = clock()

    def join(self) -> Post:
        """Return a new page's post, with what is known already."""
        post = Post()
        for kind in ("setup", "snapshot", "preview-result", "refused"):
            if kind in self._newest:
                post.put(kind, self._newest[kind])
        self.posts.add(post)
        return post

    def leave(self, post: Post) -> None:
        """Let a page go."""
        self.posts.discard(post)

    async def read(self) -> None:
        """Read the mail until cancelled."""
        while True:
            self.look()
            await asyncio.sleep(LOOK_S)

    def look(self) -> None:
        """Take in what has arrived."""
        for name, inbox in self._inboxes.items():
            for letter in inbox.read(8):
                try:
                    value = decode_station(letter.data, letter.received_ns).value
                except WireError:
                    continue
                if isinstance(value, Snapshot | Setup | PreviewResult | Handle):
                    self._take(name, value)
        if self._told != self.refused and self._clock() - self._told_ns > TELL_S * 1e9:
            self._told, self._told_ns = self.refused.copy(), self._clock()
            self._tell("refused", json.dumps(self.refused))

    def _take(self, name: str, value: Snapshot | Setup | PreviewResult | Handle) -> None:
        if isinstance(value, Snapshot):
            self._seen_ns[value.number] = self._clock()
            while len(self._seen_ns) > REMEMBERED:
                del self._seen_ns[next(iter(self._seen_ns))]
        elif isinstance(value, Setup):
            self.setup = value
        self._tell(name, as_json(value).decode())

    def _tell(self, name: str, value: str) -> None:
        """Tell all pages something new, as JSON."""
        text = f'{{"say":"{name}","is":{value}}}'
        if name == "setup" and self._newest.get(name) == text:
            return
        self._newest[name] = text
        for post in self.posts:
            post.put(name, text)

    def late(self, seen: int) -> bool:
        """Return whether a page that has seen that snapshot last speaks of what is long past."""
        at = self._seen_ns.get(seen)
        limit_ms = 500.0 if self.setup is None else self.setup.round_trip_ms
        return at is None or (self._clock() - at) * 1e-6 > limit_ms

    def stamp(self, source: str) -> Stamp:
        """Return a stamp of now."""
        return Stamp(self.machine_id, self._clock(), source)

    def intent(self, intent: Intent, sequence: int) -> None:
        """Pass an intent on."""
        self._mail.publish(topic(self.machine_id, "intent"), encode(intent, sequence))

    def request(self, request: Request) -> None:
        """Pass a request on."""
        self._mail.publish(topic(self.machine_id, "request"), encode_station(request))

    def camera(self, camera: Camera) -> None:
        """Pass a camera on to the view."""
        self._mail.publish(topic(self.machine_id, "camera"), encode_station(camera))
