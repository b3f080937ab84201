"""Decides, from a request's token, server name and origin, whether its sender may see or control a run."""

from __future__ import annotations

import hmac
import ipaddress
import os
import re
import secrets
from dataclasses import dataclass
from email.message import Message
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from fourd.base.errors import UserError

TOKEN_VARIABLE = "FOURD_TOKEN"
REQUEST_HEADER = "X-Fourd-Request"
_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")
_TOKEN_BYTES = 18
_MAX_COOKIES = 4096
_NO_TOKEN = "This run needs a token. Open the address that fourd serve has printed; it ends with ?token=..."
_WRONG_TOKEN = "The token is wrong. Open the address that fourd serve has printed when it was started last."


def choose_token(option: str | None, host: str) -> str | None:
    """Return the token that the server requires, or None if no token was set and only this machine can connect.

    The token comes from the option ``--token`` or else from the environment variable FOURD_TOKEN. If neither is set and
    other machines can connect, the token is random.

    Raises UserError if the token is too short or has characters that are not allowed. The message does not contain the
    token.
    """
    source = "--token" if option is not None else TOKEN_VARIABLE
    token = option if option is not None else os.environ.get(TOKEN_VARIABLE)
    if token is None:
        return None if is_loopback(host) else secrets.token_urlsafe(_TOKEN_BYTES)
    if _TOKEN.fullmatch(token) is None:
        raise UserError(
            f"{source}: expected 16 to 128 letters, digits, '-' or '_', got {len(token)} characters; without a token, "
            "fourd serve makes one"
        )
    return token


def is_loopback(host: str) -> bool:
    """Return True if only this machine can connect to an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Access:
    """The rules for requests to one server.

    Attributes:
        host: the address on which the server listens.
        token: the token that each request needs, or None.
    """

    host: str
    token: str | None

    def is_token(self, text: str) -> bool:
        """Return True if ``text`` is the token. The comparison takes constant time, so that its duration reveals
        nothing about the token."""
        return self.token is not None and hmac.compare_digest(text.encode(), self.token.encode())

    def refusal(self, headers: Message, cookie: str, given: str | None) -> str | None:
        """Return why a request is refused, as a sentence for the user, or None if the request is accepted.

        Args:
            headers: the headers of the request.
            cookie: name of the cookie that contains the token.
            given: the token in the address of the request, or None.
        """
        if self.token is None:
            return self._refuse_name(headers.get("Host", ""))
        if given is not None:
            return None if self.is_token(given) else _WRONG_TOKEN
        kept = _read_cookie(headers.get("Cookie", ""), cookie)
        if kept is None:
            return _NO_TOKEN
        return None if self.is_token(kept) else _WRONG_TOKEN

    def refusal_of_control(self, headers: Message) -> str | None:
        """Return why a request that changes the training is refused, as a sentence for the user, or None if it is
        accepted.

        A page of another site must not control the training through the user's browser. The request therefore needs the
        header X-Fourd-Request. Before a browser sends this header for a page of another site, it asks this server for
        permission (CORS preflight), and the server never gives it. If the request also has an Origin header, it must
        name this server.
        """
        if headers.get(REQUEST_HEADER) != "control":
            return f"Requests to a training need the header {REQUEST_HEADER}: control."
        origin = headers.get("Origin")
        is_same = origin is None or urlsplit(origin).netloc == headers.get("Host", "")
        if not is_same or headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            return "The request comes from a page of another site. Use the page of fourd serve."
        return None

    def _refuse_name(self, host: str) -> str | None:
        """Refuse a request whose Host header does not name this machine.

        This prevents DNS rebinding: the owner of a domain can make its name resolve to this machine, so that a browser
        would treat pages of that domain as pages of this server.
        """
        name = _name_of(host)
        if name == self.host or is_loopback(name):
            return None
        return "This server has another name. Open the address that fourd serve has printed."


def _name_of(host: str) -> str:
    """Return the name in a Host header, without the port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _read_cookie(header: str, name: str) -> str | None:
    if len(header) > _MAX_COOKIES:
        return None
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return None
    return None if found is None else found.value
