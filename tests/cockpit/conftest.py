"""The page's server on a post of its own, a machine that is only a mailbox."""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
import yaml

pytest.importorskip("starlette", reason="the cockpit's extra is not installed")
pytest.importorskip("websockets", reason="the cockpit's extra is not installed")

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it would rather have a later client
    from starlette.testclient import TestClient

from workgauge.bus.memory_mail import MemoryMail, MemoryPost
from workgauge.cockpit.access import Access
from workgauge.cockpit.hub import Hub
from workgauge.cockpit.server import Cockpit
from workgauge.rehearse.shipped import shipped_path
from workgauge.values.mail import Mail
from workgauge.values.measurements import Stamp
from workgauge.values.station import Heard, Setup, Snapshot
from workgauge.wire.messages import decode
from workgauge.wire.station import decode_station, encode_station, topic

MACHINE = "rre20"
ORIGIN = {"origin": "http://localhost:8600", "host": "localhost:8600"}


def a_snapshot(number: int = 1, **changed: object) -> Snapshot:
    rest = {
        "t_s": 1.0, "doing": "idle", "step": "", "driver": "", "wanted_by": "", "round_trip_ms": None,
        "intent_age_ms": None, "intent": 0, "stopped": "", "enabled": False, "q": (0.0,), "pose": (0.0,) * 12,
        "stop_q": (0.0,), "desired": (0.0,), "allowed": (0.0,), "valves": (0,), "levers": (0.0,) * 6, "scale": 1.0,
        "near": (), "held": (), "ranges": (), "health": "perfect", "health_reasons": (), "guard": "barrier",
        "settings": (), "off_states": (), "let_off": (), "suspended": (), "preview": "", "previewing": False,
        "running": "", "job": "", "tick_ms": (1.0, 2.0), "late_ticks": 0, "heard": Heard(), "answers": (),
        "events": (),
    }  # fmt: skip
    return Snapshot(Stamp(MACHINE, 1, "machine"), number, **(rest | changed))  # type: ignore[arg-type]


def a_setup() -> Setup:
    stamp = Stamp(MACHINE, 1, "machine")
    return Setup(stamp, "title", MACHINE, "site", "rules", (), (), (), True, (), 200.0, 500.0, 10.0)


@dataclass
class Bench:
    """The server, and the machine's end of its mail."""

    machine: Mail
    hub: Hub
    client: TestClient
    intents: object = field(init=False)
    requests: object = field(init=False)
    cameras: object = field(init=False)

    def __post_init__(self) -> None:
        self.intents = self.machine.inbox(topic(MACHINE, "intent"), 1000)
        self.requests = self.machine.inbox(topic(MACHINE, "request"), 1000)
        self.cameras = self.machine.inbox(topic(MACHINE, "camera"), 10)

    def tell(self, value: object, name: str) -> None:
        self.machine.publish(topic(MACHINE, name), encode_station(value))  # type: ignore[arg-type]
        self.hub.look()

    def got(self, inbox: object) -> list[object]:
        read = decode if inbox is self.intents else decode_station
        return [read(one.data, one.received_ns).value for one in inbox.read()]  # type: ignore[attr-defined]


def bench_with(access: Access) -> Iterator[Bench]:
    post = MemoryPost()
    hub = Hub(MemoryMail(post), MACHINE)
    app = Cockpit(hub, access, "ws://127.0.0.1:9").app()
    with TestClient(app, base_url="http://localhost:8600") as client:
        yield Bench(MemoryMail(post), hub, client)


@pytest.fixture
def bench() -> Iterator[Bench]:
    yield from bench_with(Access("127.0.0.1", 8600))


@pytest.fixture
def locked() -> Iterator[Bench]:
    yield from bench_with(Access("0.0.0.0", 8600, "operator-token-1", "supervisor-token"))


@pytest.fixture
def conf() -> object:
    """Makers of messages."""
    import types

    return types.SimpleNamespace(a_setup=a_setup, a_snapshot=a_snapshot)


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    """All processes, begun once; the rule book lets poles be suspended for ten minutes."""
    from stack import Stack

    rules = yaml.safe_load(shipped_path("rules", "finland.yaml").read_text())
    rules["may_suspend"] = [{"rule": "catenary-pole", "at_most_min": 10}]
    path = tmp_path_factory.mktemp("rules") / "rules.yaml"
    path.write_text(yaml.safe_dump(rules))
    begun = Stack.begin(rules=path)
    yield begun
    begun.end()


@pytest.fixture(scope="session")
def browser() -> Iterator[object]:
    from stack import CHROMIUM, FLAGS, no_browser

    if why := no_browser():
        pytest.skip(why)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield found
        found.close()


@pytest.fixture
def contexts(stack, browser) -> Iterator[Callable[..., object]]:
    """Make browser contexts, each a person of its own; whoever still has the seat leaves it at the end."""
    made = []

    def another(**given: object) -> object:
        made.append(browser.new_context(**({"viewport": {"width": 1024, "height": 768}} | given)))
        return made[-1]

    yield another
    for one in made:
        for page in one.pages:
            page.evaluate(
                "{ const leave = document.getElementById('leave'); if (leave && !leave.hidden) leave.click(); }"
            )
        one.close()
    stack.until(lambda now: not now.driver, "the seat is free")


@pytest.fixture
def page(stack, contexts) -> object:
    from stack import opened

    return opened(contexts(), stack)
