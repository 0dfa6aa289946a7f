"""A page for browsers on this computer."""

from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

from parapod.sims.lab.panel import PORTS
from parapod.systems.core.errors import OutputError

_LOCAL = "localhost"


class PageServer(ThreadingHTTPServer):
    """Serves one page until it is closed; `serve_forever` waits.

    Attributes:
        page: content of the page.
    """

    daemon_threads = True

    def __init__(self, page: str):
        """Takes the first free port.

        Raises:
            OutputError: no port is free.
        """
        self.page = page.encode()
        for port in PORTS:
            try:
                super().__init__(("127.0.0.1", port), _Handler)
                return
            except OSError:
                continue
        raise OutputError(f"no port of {PORTS[0]}..{PORTS[-1]} is free on this computer", None)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{_LOCAL}:{self.server_port}"


class _Handler(BaseHTTPRequestHandler):
    server: PageServer

    def do_GET(self) -> None:
        # Asked for by this computer's name: a stranger's page may not read it.
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        if host not in (_LOCAL, "127.0.0.1"):
            self.send_error(HTTPStatus.FORBIDDEN)
        elif urlsplit(self.path).path != "/":
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(self.server.page)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(self.server.page)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Says nothing of each request."""
