"""Who may open the page: its own origin only, with a token wherever others than this computer can reach it."""

import hmac
import ipaddress
import secrets
from dataclasses import dataclass
from enum import StrEnum

from workgauge.values.errors import InputError

#: The cookie a token is kept in.
COOKIE = "workgauge"
#: A token has at least so many characters.
SHORTEST_TOKEN = 16


class Role(StrEnum):
    """What a page may do."""

    OPERATOR = "operator"  #: drive, if the seat is free
    SUPERVISOR = "supervisor"  #: that, and suspend limits where the rule book allows it


def loopback(host: str) -> bool:
    """Return whether an address is reached from this computer alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """Return a token nobody guesses."""
    return secrets.token_urlsafe(24)


@dataclass(frozen=True, slots=True)
class Access:
    """Who may open the page.

    Attributes:
        host, port: where it is served. token: of operators; None where this computer alone reaches it.
        supervisor: the supervisor's token, None for no supervisor.
        names: further host names the page is reached by.
    """

    host: str
    port: int
    token: str | None = None
    supervisor: str | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not loopback(self.host) and self.token is None:
            raise InputError("a page that others can reach needs a token", element="host", value=self.host)
        for name, one in (("token", self.token), ("supervisor", self.supervisor)):
            if one is not None and (len(one) < SHORTEST_TOKEN or not one.isascii() or not one.isprintable()):
                raise InputError(
                    "too easy to guess", element=name, allowed=f"at least {SHORTEST_TOKEN} printable characters"
                )

    def role(self, token: str | None) -> Role | None:
        """Return what a token opens; None for nothing. Without tokens everybody on this computer is an operator."""
        given = (token or "").encode()
        if self.supervisor is not None and hmac.compare_digest(given, self.supervisor.encode()):
            return Role.SUPERVISOR
        if self.token is None or hmac.compare_digest(given, self.token.encode()):
            return Role.OPERATOR
        return None

    def host_known(self, host: str | None) -> bool:
        """Return whether a request was meant for this page: its `Host`. Where only this computer reaches it, names
        that are not this computer's are refused: another page's script could otherwise speak to it under a name of
        its own.
        """
        if host is None:
            return False
        name, _, port = host.rpartition(":") if not host.endswith("]") and ":" in host else (host, "", "80")
        name = name.strip("[]").lower()
        if not loopback(self.host):
            return True
        return port == str(self.port) and (loopback(name) or name in self.names)

    def origin_own(self, origin: str | None, host: str | None) -> bool:
        """Return whether a web socket was opened by this page: its `Origin` names the host it speaks to."""
        if origin is None or host is None:
            return False
        scheme, _, rest = origin.partition("://")
        return scheme in ("http", "https") and rest.lower() == host.lower()
