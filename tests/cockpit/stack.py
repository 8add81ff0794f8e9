"""The real thing for tests: all processes, and people on its page."""

import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from workgauge.app.cockpit_processes import Minder, Plan, free_port
from workgauge.bus.zenoh_mail import ZenohMail
from workgauge.cockpit.access import Access
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.station.desk import DeskSettings
from workgauge.values.station import Snapshot
from workgauge.wire.station import decode_station, topic

TOKEN, SUPERVISOR = "operator-of-the-tests", "supervisor-of-the-tests"
CHROMIUM = next((found for name in ("chromium", "chromium-browser") if (found := shutil.which(name))), None)
#: Drawn by the processor, nothing looked up elsewhere.
FLAGS = [
    "--no-sandbox", "--disable-dev-shm-usage", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip


def wait_until(true: Callable[[], object], patience_s: float = 20.0, what: str = "") -> None:
    give_up = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < give_up, f"never: {what}"
        time.sleep(0.02)


@dataclass
class Stack:
    """All processes, and an ear of the tests' own on the machine."""

    minder: Minder
    plan: Plan
    mail: ZenohMail
    said: list[str]
    newest: Snapshot | None = None
    inbox: object = field(default=None)

    @classmethod
    def begin(
        cls,
        scenario: str = "pole-approach",
        *,
        token: str | None = TOKEN,
        rules: Path | None = None,
        joints: str = "ideal",
        intent_age_s: float = 1.0,
        round_trip_s: float = 4.0,
        gone_s: float = 2.0,
    ) -> "Stack":
        loaded = load_scenario(scenario).choosing(guard="barrier", joints=joints, rules=rules)  # type: ignore[arg-type]
        name = open_session(loaded).machine_id
        access = Access("127.0.0.1", free_port(), token, None if token is None else SUPERVISOR)
        # a browser that draws with the processor, on two cores, is slower than any operator's
        desk = DeskSettings(intent_age_s=intent_age_s, round_trip_s=round_trip_s, gone_s=gone_s)
        plan = Plan.of(loaded, desk, access, name)
        said: list[str] = []
        minder = Minder(plan, said.append)
        minder.start()
        mail = ZenohMail(connect=plan.bus("preview")["connect"])
        return cls(minder, plan, mail, said, inbox=mail.inbox(topic(name, "snapshot"), 4))

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.plan.access.port}/"

    def now(self) -> Snapshot:
        """Return the newest snapshot, at least one newer than the last."""
        before = self.newest

        def heard() -> bool:
            for letter in self.inbox.read():  # type: ignore[attr-defined]
                self.newest = decode_station(letter.data, letter.received_ns).value
            return self.newest is not None and self.newest is not before

        wait_until(heard, what="a snapshot")
        assert self.newest is not None
        return self.newest

    def until(self, true: Callable[[Snapshot], object], what: str, patience_s: float = 20.0) -> Snapshot:
        give_up = time.monotonic() + patience_s
        while not true(now := self.now()):
            assert time.monotonic() < give_up, f"never: {what}; {now.held[:2]} {now.events[-3:]}"
        return now

    def kill(self, name: str) -> None:
        """End one process as a crash would."""
        process = self.minder.running[name]
        assert process.pid is not None
        os.kill(process.pid, 9)
        process.join(5.0)

    def end(self) -> None:
        self.mail.close()
        self.minder.stop()


def no_browser() -> str:
    """Return why the page cannot be opened in a browser here, empty if it can."""
    if not find_spec("playwright"):
        return "playwright is not installed: the page is NOT tested in a browser"
    return "" if CHROMIUM else "NO CHROMIUM on this computer: the page is NOT tested in a browser"


def opened(context: Any, stack: Stack, token: str = TOKEN, *, view: bool = False) -> Any:
    """Open the page; without the view, which takes the processor's whole time to draw."""
    page = context.new_page()
    page.on("pageerror", lambda error: print("page:", str(error)[:200]))
    if not view:
        page.route("**/view/**", lambda route: route.abort())
    page.goto(f"{stack.address}?token={token}")
    wait_until(lambda: page.inner_text("#clock") != "0.0 s", what="the machine is there")
    return page


def shows(page: Any, where: str, words: str) -> None:
    """Wait until a part of the page says something."""
    wait_until(lambda: words in page.inner_text(where), what=f"{where} says {words}")


def seated(page: Any, stack: Stack) -> None:
    """Take the seat, put the machine back to its start, and press Enable."""
    page.click("#take")
    stack.until(lambda now: now.driver, "the seat is taken")
    page.wait_for_selector("#leave", state="visible", timeout=20_000)
    if page.locator("#clear").is_visible():
        page.click("#clear")
    page.click("#restart")
    stack.until(lambda now: now.t_s < 2.0 and now.driver, "back at the start", 40.0)
    shows(page, "#seatText", "you drive")
    page.keyboard.press("Enter")
    stack.until(lambda now: now.enabled, "enabled")
