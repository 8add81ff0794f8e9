"""The real stack: browser, page, view, Zenoh, machine; what an operator does, and what may go wrong meanwhile."""

import pytest

for part in ("zenoh", "viser", "starlette", "uvicorn"):
    pytest.importorskip(part, reason="the cockpit's extra is not installed")

from stack import Stack, opened, seated, shows, wait_until  # noqa: E402

# all processes, in real time: not beside other tests
pytestmark = pytest.mark.stack


def test_a_wrong_token_is_refused(stack: Stack, browser) -> None:
    context = browser.new_context()
    page = context.new_page()
    for address in (stack.address, f"{stack.address}?token=wrong", f"{stack.address}page/main.js"):
        response = page.goto(address)
        assert response.status == 403
        assert "token" in page.inner_text("body")
    context.close()


def test_a_key_drives_the_guard_stops_and_the_page_says_which_limit(page, stack: Stack) -> None:
    seated(page, stack)
    page.keyboard.down("a")
    stack.until(lambda now: abs(now.allowed[0]) > 0.05, "it moves")
    now = stack.until(lambda now: now.held and now.held[0].scale is not None and now.held[0].scale < 0.05, "held")
    assert now.held[0].limit == "Pole P1-12"
    assert 0.19 < min(one.distance_m for one in now.near if one.kind != "self") < 0.3
    shows(page, "#heldWhat", "Pole P1-12")
    assert "0.2" in page.inner_text("#heldWhy")
    page.keyboard.up("a")
    stack.until(lambda now: not any(now.valves), "the key is let go")
    page.keyboard.down("d")  # away from it: never held
    now = stack.until(lambda now: abs(now.allowed[0]) > 0.05, "it backs away")
    assert abs(now.allowed[0]) > 0.99 * abs(now.desired[0])
    page.keyboard.up("d")


def test_the_stop_key_stops_and_stays(page, stack: Stack) -> None:
    seated(page, stack)
    page.keyboard.down("d")
    stack.until(lambda now: any(now.valves), "it moves")
    page.keyboard.press("Space")
    now = stack.until(lambda now: now.stopped, "stopped")
    assert not any(stack.now().valves)
    page.keyboard.up("d")
    shows(page, "#heldWhat", "Stopped")
    assert "stopped by page-" in page.inner_text("#heldWhy")
    assert not now.enabled or not stack.now().enabled
    assert page.locator("#enable").is_disabled()
    page.click("#clear")
    stack.until(lambda now: not now.stopped, "cleared")


def test_the_scenario_plays(page, stack: Stack) -> None:
    seated(page, stack)
    page.click("#play")
    stack.until(lambda now: now.doing == "scenario" and any(now.valves), "it plays", 40.0)
    shows(page, "#step", "towards the limit")
    assert "scenario" in page.inner_text("#doing")


def test_a_state_that_is_switched_appears_and_acts(page, stack: Stack) -> None:
    seated(page, stack)
    box = page.locator("#states input[value='Track 2 open to traffic']")
    assert box.is_checked()
    assert any(one.limit == "track:Track 2" for one in stack.now().near)
    box.click()
    stack.until(lambda now: now.off_states == ("Track 2 open to traffic",), "switched off")
    stack.until(lambda now: not any(one.limit == "track:Track 2" for one in now.near), "it counts no more")
    wait_until(lambda: "Track 2" not in page.inner_text("#near"), what="the table says so, too")
    box.click()
    stack.until(lambda now: any(one.limit == "track:Track 2" for one in now.near), "it counts again")


def test_a_second_page_cannot_drive_until_the_first_hands_over(page, stack: Stack, contexts) -> None:
    seated(page, stack)
    first = stack.now().driver
    other = opened(contexts(), stack)
    shows(other, "#take", "Ask for the seat")
    other.keyboard.press("Enter")
    other.keyboard.down("d")
    other.click("#take")
    now = stack.until(lambda now: now.wanted_by, "asked for")
    assert now.driver == first
    assert not any(now.valves)
    page.click("#give")
    now = stack.until(lambda now: now.driver != first, "handed over")
    assert not now.enabled
    other.keyboard.up("d")
    shows(other, "#seatText", "you drive")
    other.keyboard.press("Enter")
    stack.until(lambda now: now.enabled, "the second page may drive now")


def test_the_guard_is_chosen_with_a_word_of_confirmation(page, stack: Stack) -> None:
    seated(page, stack)
    page.select_option("#guard", "linear")
    page.fill("#settings input[name=stop_distance_m]", "0.3")
    page.click("#guardSet")
    assert "stop distance 0.30 m" in page.inner_text("#askText")
    page.click("#ask button[value=no]")
    assert stack.now().guard == "barrier"
    page.click("#guardSet")
    page.click("#ask button[value=yes]")
    now = stack.until(lambda now: now.guard == "linear", "the guard is another")
    assert dict(now.settings)["stop_distance_m"] == 0.3
    assert not now.enabled
    assert any("guard linear" in one.text for one in now.events)


def test_flooding_and_nonsense_do_not_reach_the_machine(page, stack: Stack) -> None:
    seated(page, stack)
    before = stack.now()
    page.evaluate(
        """() => { const s = new WebSocket(location.origin.replace('http', 'ws') + '/link');
        s.onopen = () => { for (let i = 0; i < 5000; i++) s.send(i % 2 ? 'x'.repeat(9000) : JSON.stringify(
            {say: 'hands', n: i, seen: 1, mode: 'joint', levers: [1, 0, 0, 0, 0, 0], enable: true})); };
        window.shownOut = new Promise((done) => { s.onclose = (event) => done(event.code); }); }"""
    )
    assert page.evaluate("window.shownOut") == 1008
    now = stack.now()
    assert now.driver == before.driver
    assert now.enabled
    assert not any(now.valves)


def test_a_killed_page_leaves_the_machine_stopped_and_a_new_one_picks_up(page, stack: Stack) -> None:
    seated(page, stack)
    page.keyboard.down("d")
    stack.until(lambda now: any(now.valves), "it moves")
    stack.kill("page")
    now = stack.until(lambda now: not any(now.valves), "silence stops it")
    assert not now.stopped
    stack.until(lambda now: not now.driver, "the seat is free")
    assert stack.minder.running["machine"].is_alive()

    def again() -> bool:
        assert stack.minder.mind()
        return stack.minder.running["page"].is_alive()

    wait_until(again, what="the page's server begins again")
    page.keyboard.up("d")
    shows(page, "#doing", "nobody drives")
    seated(page, stack)
    assert any("page process has ended" in text for text in stack.said)


def test_a_killed_view_or_preview_does_not_matter(page, stack: Stack) -> None:
    seated(page, stack)
    page.keyboard.down("d")
    stack.until(lambda now: any(now.valves), "it moves")
    stack.kill("view")
    stack.kill("preview")
    for _ in range(10):
        now = stack.now()
        assert now.enabled and any(now.valves)
    page.keyboard.up("d")
    wait_until(lambda: stack.minder.mind() and stack.minder.running["view"].is_alive(), what="the view is back")
    wait_until(lambda: stack.minder.mind() and stack.minder.running["preview"].is_alive(), what="the preview is back")
