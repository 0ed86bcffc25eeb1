"""The server of a page: viser's, for browsers that were given the page's address, and for no other
page in them.

A browser lets every page that it shows open a websocket to this machine. Each request must
therefore name a token that only the page's address has, and a host that is this machine (DNS
rebinding gives a foreign one); a websocket must come from a page of this server (its Origin). See
RFC 6455, section 10.2, and "Cross-site WebSocket hijacking" of OWASP.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hmac
import html
import http
import io
import json
import re
import secrets
import threading
from collections.abc import Callable
from types import FunctionType, SimpleNamespace
from typing import Any, Literal, Self

from kempe.errors import MissingExtraError, UnsupportedError

try:
    import viser
    import websockets.asyncio.server
    from viser import infra
    from viser._messages import RunJavascriptMessage
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response
except ImportError as error:
    raise MissingExtraError(error.name or "viser", "view") from None

HOST = "127.0.0.1"
"""Pages are for this machine only."""
OWN_HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.IGNORECASE)
"""Hosts in addresses of pages on this machine; a port that was forwarded may be any."""
TOKEN_BYTES = 24
"""Random bytes of a token."""
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; worker-src "
    "data: blob:; style-src 'self' 'unsafe-inline'; font-src 'self' data: blob:; img-src 'self' "
    "data: blob:; connect-src {connect}data: blob:; base-uri 'none'; form-action 'none'"
)
"""What a page may load: what comes with it. A browser requests nothing else, whatever a name or a
file says."""

INDEX = ("", "index.html")
"""Paths of the page itself."""
DARK = (
    "<script>if(matchMedia('(prefers-color-scheme: dark)').matches&&!location.search)"
    "history.replaceState(null,'','?darkMode')</script>"
)
"""Makes a page dark where the browser prefers that, by viser's option in the address."""

Handler = Callable[[Any, Request], "Response | None"]


class Guard:
    """Decides about the requests to one server; `token` is the first part of the path of its page,
    which has a `title`.
    """

    def __init__(self, title: str = "Kempe") -> None:
        self.title = title
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self.active = False

    def wrap_server(self, serve: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap the function `serve` of websockets, so that the guard decides requests first."""

        def serve_guarded(handler: Any, *where: Any, process_request: Handler, **how: Any) -> Any:
            """Serve with the guard in front of the handler of requests."""

            def answer_handshake(connection: Any, request: Request) -> Response | None:
                """Decide a request before its own handler sees it."""
                return self.answer_request(connection, request, process_request)

            self.active = True
            return serve(handler, *where, process_request=answer_handshake, **how)

        return serve_guarded

    def answer_request(
        self, connection: Any, request: Request, further: Handler
    ) -> Response | None:
        """Answer a request: refuse it, or pass it on to `further`.

        The answer is None where a websocket opens.
        """
        host = _read_header(request, "Host")
        if host is None or not OWN_HOST.fullmatch(host):
            return _make_refusal("the request names a host that is not this machine")
        token, _, rest = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return _make_refusal(
                "the address is incomplete: open the one that Kempe printed, which ends in a token"
            )
        headers = request.headers.copy()
        if rest in INDEX:  # the page itself, whose text is compressed already
            headers.pop("Accept-Encoding", None)
        found = further(connection, dataclasses.replace(request, path=f"/{rest}", headers=headers))
        if found is None and _read_header(request, "Origin") not in (
            f"http://{host}",
            f"https://{host}",
        ):
            return _make_refusal("the websocket was opened by a page of another origin")
        if found is not None:
            connect = f"'self' ws://{host} wss://{host} "
            found.headers["Content-Security-Policy"] = POLICY.format(connect=connect)
            found.headers["Referrer-Policy"] = "no-referrer"
            found.headers["X-Content-Type-Options"] = "nosniff"
            if rest in INDEX:
                found.body = set_title(found.body.decode(), self.title, DARK).encode()
                del found.headers["Content-Length"]
                found.headers["Content-Length"] = str(len(found.body))
        return found


class PageServer(viser.ViserServer):
    """A server of viser on this machine, at `url`, that answers only requests with the token of
    this address.
    """

    def __init__(self, port: int, label: str | None = None):
        self.guard = guard = Guard(label or "Kempe")

        class Sockets(infra.WebsockServer):
            """Viser's server of websockets, which gives its requests to the guard."""

            def _background_worker(self, ready_sem: Any) -> None:
                theirs: Any = websockets
                server = _replace_names(
                    theirs.asyncio.server, serve=guard.wrap_server(theirs.asyncio.server.serve)
                )
                own = _replace_names(theirs, asyncio=_replace_names(theirs.asyncio, server=server))
                _bind_globals(infra.WebsockServer._background_worker, websockets=own)(
                    self, ready_sem
                )

        begin = _bind_globals(
            viser.ViserServer.__init__, infra=_replace_names(infra, WebsockServer=Sockets)
        )
        silence_action(lambda: begin(self, host=HOST, port=port, label=label, verbose=False))
        if not guard.active:  # another version of viser is built otherwise
            silence_action(self.stop)
            raise UnsupportedError(
                f"viser {viser.__version__} cannot be kept from foreign pages; install viser 1.1"
            )

    @property
    def url(self) -> str:
        """Address of the page, with the token."""
        return f"http://{HOST}:{self.get_port()}/{self.guard.token}"


class ServedPages:
    """Pages of one server, which has a title: one for each client, until they are closed.

    `up` is the direction upwards in the pages.
    """

    def __init__(self, port: int, title: str, up: Literal["+y", "+z"]):
        self.pages: dict[int, Any] = {}
        self._closed = threading.Event()
        self.server = PageServer(port, title)
        self.server.gui.main_panel.dock_right()
        self.server.scene.set_up_direction(up)

    @property
    def url(self) -> str:
        """Address of the page, with the token that the page requires."""
        return self.server.url

    def _accept_clients(self) -> None:
        """Open pages for all clients from now on."""
        self.server.on_client_connect(self._open_page)
        self.server.on_client_disconnect(self._close_page)

    def _open_page(self, client: Any) -> None:
        """Add a page for a new client."""
        raise NotImplementedError

    def _close_page(self, client: Any) -> None:
        """Close the page of a client that has left."""
        page = self.pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    def wait(self) -> None:
        """Wait until the pages are closed; Ctrl-C closes them."""
        try:
            while not self._closed.wait(0.2):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Close the pages and stop the server."""
        if not self._closed.is_set():
            self._closed.set()
            for page in tuple(self.pages.values()):
                page.close()
            silence_action(self.server.stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def set_title(page: str, title: str, more: str = "") -> str:
    """Set the title of a page of viser, and add HTML to its head."""
    return page.replace("<title>Viser</title>", f"<title>{html.escape(title)}</title>{more}", 1)


def copy_text(client: Any, text: str) -> None:
    """Copy a text to the clipboard of a browser."""
    source = f"navigator.clipboard.writeText({json.dumps(text)})"
    client.gui._websock_interface.queue_message(RunJavascriptMessage(source=source))


def save_text(client: Any, name: str, text: str) -> str:
    """Let a browser save a text as a TOML file; return the name of the file."""
    stem = re.sub(r"\W+", "_", name) or "mechanism"
    file = f"{stem}.toml"
    client.send_file_download(file, text.encode(), save_immediately=True)
    return file


def silence_action(action: Callable[[], Any]) -> Any:
    """Run an action without its printed output, and return its result."""
    with contextlib.redirect_stdout(io.StringIO()):
        return action()


def _bind_globals(function: Any, **names: Any) -> Callable[..., Any]:
    """Copy a function of another package with some of its global names replaced."""
    scope = {**function.__globals__, **names}
    made = FunctionType(
        function.__code__, scope, function.__name__, function.__defaults__, function.__closure__
    )
    made.__kwdefaults__ = function.__kwdefaults__
    return made


def _replace_names(module: Any, **names: Any) -> SimpleNamespace:
    """Copy the names of a module, with some of them replaced."""
    return SimpleNamespace(**{**vars(module), **names})


def _read_header(request: Request, name: str) -> str | None:
    """Return the value of a header that occurs once in a request, else None."""
    values = request.headers.get_all(name)
    return values[0] if len(values) == 1 else None


def _make_refusal(why: str) -> Response:
    """Make the response that refuses a request, with its reason."""
    body = f"Refused: {why}.\n".encode()
    headers = Headers(
        {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    )
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
