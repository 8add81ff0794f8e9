"""Who may open the page."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("starlette", reason="the cockpit's extra is not installed")

from starlette.websockets import WebSocketDisconnect

from workgauge.cockpit.access import COOKIE, Access, Role, loopback, new_token
from workgauge.values.errors import InputError

OWN = {"origin": "http://localhost:8600", "host": "localhost:8600"}
PATHS = ("/", "/page/main.js", "/page/cockpit.css", "/view/page-1/")


def test_what_others_can_reach_needs_a_token() -> None:
    with pytest.raises(InputError, match="token"):
        Access("0.0.0.0", 8600)
    with pytest.raises(InputError, match="guess"):
        Access("0.0.0.0", 8600, "short")
    Access("0.0.0.0", 8600, new_token())
    Access("::1", 8600)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.9.9.9", "::1", "localhost"])
def test_loopback_is_this_computer_alone(host: str) -> None:
    assert loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "10.0.0.1", "example.org", ""])
def test_anything_else_is_not(host: str) -> None:
    assert not loopback(host)


@given(st.text())
def test_no_other_token_opens_anything(token: str) -> None:
    access = Access("0.0.0.0", 8600, "a-token-of-the-operator", "a-token-of-the-supervisor")
    expected = {access.token: Role.OPERATOR, access.supervisor: Role.SUPERVISOR}.get(token)
    assert access.role(token) is expected


def test_without_a_token_nobody_is_a_supervisor() -> None:
    assert Access("127.0.0.1", 8600).role(None) is Role.OPERATOR
    assert Access("127.0.0.1", 8600, None, "a-token-of-the-supervisor").role("x") is Role.OPERATOR


@pytest.mark.parametrize("path", PATHS)
def test_on_this_computer_everything_opens(bench, path: str) -> None:
    response = bench.client.get(path)
    assert response.status_code == 200
    assert "frame-ancestors" in response.headers["content-security-policy"]


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("host", ["evil.example:8600", "localhost:80", "localhost.evil.example:8600", "127.0.0.1"])
def test_a_name_that_is_not_this_computers_opens_nothing(bench, path: str, host: str) -> None:
    assert bench.client.get(path, headers={"host": host}).status_code == 403


@pytest.mark.parametrize("path", PATHS)
def test_a_wrong_token_or_none_opens_nothing(locked, path: str) -> None:
    assert locked.client.get(path).status_code == 403
    assert locked.client.get("/?token=operator-token-2").status_code == 403
    locked.client.cookies.set(COOKIE, "operator-token-2")
    assert locked.client.get(path).status_code == 403


@pytest.mark.parametrize("path", PATHS)
def test_the_right_token_goes_into_a_cookie_and_opens(locked, path: str) -> None:
    response = locked.client.get("/?token=operator-token-1", follow_redirects=False)
    assert response.status_code == 303
    cookie = response.headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=strict" in cookie
    assert "token" not in response.headers["location"]
    assert locked.client.get(path).status_code == 200


@pytest.mark.parametrize("path", ["/link", "/view/page-1"])
@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://localhost:8601", "host": "localhost:8600"},
    ],
)
def test_a_web_socket_of_another_origin_is_refused(bench, path: str, headers: dict[str, str]) -> None:
    with pytest.raises(WebSocketDisconnect), bench.client.websocket_connect(path, headers=headers) as socket:
        socket.receive_text()


@pytest.mark.parametrize("path", ["/link", "/view/page-1"])
def test_a_web_socket_without_the_token_is_refused(locked, path: str) -> None:
    with pytest.raises(WebSocketDisconnect), locked.client.websocket_connect(path, headers=OWN) as socket:
        socket.receive_text()


@pytest.mark.parametrize(("token", "name"), [("operator-token-1", "page-"), ("supervisor-token", "supervisor-")])
def test_the_token_says_what_a_page_is_called(locked, token: str, name: str) -> None:
    locked.client.cookies.set(COOKIE, token)
    with locked.client.websocket_connect("/link", headers=OWN) as socket:
        assert socket.receive_json()["is"]["source"].startswith(name)


def test_parts_that_are_none_are_not_there(bench) -> None:
    for name in ("index.html", "nothing.js", "..%2f..%2fserver.py", "%2e%2e", "__init__.py"):
        assert bench.client.get(f"/page/{name}").status_code == 404


def test_the_whole_page_loads_its_own_parts_only(bench) -> None:
    page = bench.client.get("/").text
    assert "http://" not in page and "https://" not in page
    assert " style=" not in page and "<script>" not in page
