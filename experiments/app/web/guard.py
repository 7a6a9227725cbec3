"""Who may ask: this machine's own user with a page of this app. Other sites in the same browser, other users, may not.

Three checks, since the loopback address alone keeps out neither a web page nor another user of the machine:

- the Host is a loopback name with our port: a foreign name that resolves to 127.0.0.1 (DNS rebinding) is refused;
- the Origin, where there is one, is ours: no other site's script may post, or open the socket;
- a cookie holds the workspace's key, which the printed address brings: other users of the machine cannot read it.
  The address that a browser is started with stands in the list of processes, which they can: it has a ticket, for once.
"""

import hashlib
import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, quote, urlencode

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

LOOPBACK = ("127.0.0.1", "localhost")
HTTP = 80
PAGE_POLICY = (
    # the framework compiles its templates in the page, and styles elements in their attributes
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; font-src 'self' data:; connect-src 'self' {sockets}; frame-src 'self'; "
    "frame-ancestors 'self'; base-uri 'none'; form-action 'self'; object-src 'none'"
)
REFUSED = b"Open the address that `diffdrive app` printed in its terminal: it holds the key of this folder."
ELSEWHERE = b"This is a page of this machine for its own browser; the request came from elsewhere."


def results_token(key: str) -> str:
    """What stands in the address of results in the place of the cookie.

    A report in its sandbox has no origin, so the browser sends no cookie where it links the files beside it.
    """
    return hmac.new(key.encode(), b"results", hashlib.sha256).hexdigest()


class Guard:
    """The application behind the three checks."""

    def __init__(self, application: Application, *, port: int, key: str, ticket: str = "") -> None:
        """`ticket` lets in once, in the place of the key."""
        self._tickets = [ticket] if ticket else []
        self.app, self._key = application, key  # `app`: the framework finds its server along this name
        # browsers leave out the port that is a scheme's own
        self._hosts = {f"{name}:{port}" for name in LOOPBACK} | (set(LOOPBACK) if port == HTTP else set())
        self._results = f"/result/{results_token(key)}/"
        self._cookie = f"diffdrive-{port}"  # cookies know no ports
        sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts))
        self._headers = [
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cross-origin-resource-policy", b"same-origin"),
        ]
        self._policy = (b"content-security-policy", PAGE_POLICY.format(sockets=sockets).encode())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        host, origin = headers.get(b"host", ""), headers.get(b"origin")
        if host in self._hosts and scope["type"] == "http" and self._is_result(scope):
            await self.app(scope, receive, self._with_headers(send))
        elif host not in self._hosts or (origin is not None and origin != f"http://{host}"):
            await _refuse(scope, send, ELSEWHERE)
        elif self._knows(headers.get(b"cookie", "")):
            await self.app(scope, receive, self._with_headers(send))
        elif scope["type"] == "http" and scope["method"] == "GET" and self._brings_key(scope):
            await self._let_in(scope, send)
        else:
            await _refuse(scope, send, REFUSED)

    def _knows(self, cookies: str) -> bool:
        try:
            found = SimpleCookie(cookies).get(self._cookie)
        except CookieError:
            return False
        return found is not None and hmac.compare_digest(found.value.encode(), self._key.encode())

    def _is_result(self, scope: Scope) -> bool:
        return scope["method"] in ("GET", "HEAD") and str(scope["path"]).startswith(self._results)

    def _brings_key(self, scope: Scope) -> bool:
        key = dict(reversed(_query(scope))).get("key", "")  # the first of several
        if key in self._tickets:
            self._tickets.remove(key)
            return True
        return hmac.compare_digest(key.encode(), self._key.encode())

    async def _let_in(self, scope: Scope, send: Send) -> None:
        """Keep the key as a cookie, and take it out of the address: it is not to stand in the history."""
        path = quote("/" + str(scope["path"]).lstrip("/\\"))  # two of either would be another host
        rest = urlencode([(name, value) for name, value in _query(scope) if name != "key"])
        address = f"{path}?{rest}" if rest else path
        cookie = f"{self._cookie}={self._key}; Path=/; HttpOnly; SameSite=Strict"
        headers = [(b"location", address.encode()), (b"set-cookie", cookie.encode())]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    def _with_headers(self, send: Send) -> Send:
        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                headers = list(message.get("headers", []))
                named = {name.lower() for name, _ in headers}
                wanted = [*self._headers, self._policy]
                message["headers"] = [*headers, *(one for one in wanted if one[0] not in named)]
            await send(message)

        return sending


def _query(scope: Scope) -> list[tuple[str, str]]:
    return parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)


async def _refuse(scope: Scope, send: Send, text: bytes) -> None:
    if scope["type"] == "websocket":  # before it is accepted: the browser sees a 403
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": text})
