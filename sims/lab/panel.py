"""A page that shows a machine beside its controls: sliders, buttons, numbers and plots that live.

Meshcat's own sliders lie below the tree of its scene, and it has no text. The page frames Meshcat
and serves what stands beside it; in Python its sliders and buttons have Meshcat's own methods, so
that a system reads either.
"""

import hmac
import json
import math
import secrets
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pydrake.geometry import Meshcat

from parapod.sims.lab.stacked_plots import library
from parapod.sims.lab.strip_chart import StripChart

# The first port that is tried, so that a page that is open finds the next run, and the last.
PORTS = range(7100, 7200)
# Between two looks of the service whether it is to end [s].
_POLL = 0.05
# Longest request of a browser [bytes].
_LONGEST_REQUEST = 4096
# A page that is silent for this time stops operating: another one may begin [s].
_LEASE = 1.0
# A button that is held says so ten times a second [s].
_HELD = 0.25
_LOCAL = "localhost"
# Without it nothing is shown or obeyed: other users of this computer reach its pages too. One for
# all pages of a program, so that an open one finds the next run.
_TOKEN = secrets.token_urlsafe(16)


@dataclass(frozen=True)
class Row:
    """A quantity on the page.

    Attributes:
        label: a word or two.
        asked: value that is asked for; None where none is.
        measured: value that the machine measures; None where it does not.
        true: true value, which only a simulation knows.
        unit: unit of all three.
        decimals: number of decimals.
    """

    label: str
    asked: float | None = None
    measured: float | None = None
    true: float | None = None
    unit: str = ""
    decimals: int = 2


@dataclass(frozen=True)
class Readout:
    """Everything that the page shows at one moment.

    Attributes:
        state: state of the machine, in a few words.
        rows: its quantities.
        remarks: faults and refusals, a sentence each.
        is_alarming: true if a person should look at the state.
        idle: names of sliders and buttons that do nothing in this state; they look so.
    """

    state: str = ""
    rows: Sequence[Row] = ()
    remarks: Sequence[str] = ()
    is_alarming: bool = False
    idle: Sequence[str] = ()


@dataclass
class _Slider:
    name: str
    low: float
    high: float
    step: float
    value: float
    # How often it was set from here: a page takes over a value that it has not seen.
    sets: int = 0

    def put(self, value: float) -> None:
        """Takes the value of the step that is nearest, within the range."""
        nearest = self.step * round(value / self.step) + 0.0  # without the sign of a zero
        self.value = min(max(nearest, self.low), self.high)


@dataclass
class _Hold:
    key: str
    until: float = -math.inf
    number: int = -1  # of the newest message about it: one that comes late is out of date

    def hear(self, is_held: bool, number: int) -> None:
        """Takes a message about it."""
        if number > self.number:
            self.number = number
            self.until = time.monotonic() + (_HELD if is_held else 0.0)


class Panel:
    """Sliders, buttons and numbers beside a Meshcat scene, served to browsers on this computer.

    Sliders and buttons are added, read and deleted as those of `Meshcat`; there are buttons
    besides that count while they are held. All methods may be called from any thread.

    Whoever asks needs the token that `web_url` ends with, also on this computer, which others may
    use at the same time.

    One page operates: the first that is opened, until it is closed or another one takes over;
    further ones only look. `silence` tells for how long nothing has been heard of it.

    Attributes:
        meshcat: the scene.
        title: title of the page.
    """

    def __init__(self, meshcat: Meshcat, title: str, host: str = _LOCAL):
        """Serves the page on a free port.

        Args:
            meshcat: the scene that is framed.
            title: title of the page.
            host: address at which it is served. Other computers reach any but "localhost".

        Raises:
            OSError: no port is free, or there is no such address here.
        """
        self.meshcat, self.title = meshcat, title
        self._run = secrets.token_hex(8)
        self._host = host
        self._lock = threading.Lock()
        self._sliders: dict[str, _Slider] = {}
        self._buttons: dict[str, int] = {}
        self._holds: dict[str, _Hold] = {}
        self._operator, self._heard = "", -math.inf
        self._readout = Readout()
        self._chart: StripChart | None = None
        self._charts = 0  # that were shown: a page asks anew for another one
        self._page = _page(title, meshcat)
        self._server = _serve(self)
        threading.Thread(target=self._server.serve_forever, args=(_POLL,), daemon=True).start()

    def __repr__(self) -> str:
        return f"<panel '{self.title}' at {self.web_url()}>"

    def web_url(self) -> str:
        """The address of the page, with its token."""
        port = self._server.server_address[1]
        name = socket.gethostname() if self._host == "0.0.0.0" else self._host
        return f"http://{name}:{port}/?token={_TOKEN}"

    def close(self) -> None:
        """Ends the service; open pages then say that the run has ended."""
        self._server.shutdown()
        self._server.server_close()

    def show(self, readout: Readout) -> None:
        """Shows what the machine does from now on."""
        with self._lock:
            self._readout = readout

    def plot(self, chart: StripChart | None) -> None:
        """Plots a chart from now on; None: nothing."""
        with self._lock:
            self._chart = chart
            self._charts += 1

    def silence(self) -> float:
        """Time since something was heard of the page that operates [s]; infinite: never."""
        with self._lock:
            return time.monotonic() - self._heard

    # Buttons that count while they are held.

    def AddHold(self, name: str, key: str = "") -> None:
        """Adds a button that counts while it is held.

        Args:
            name: name of the button.
            key: key that does the same, as browsers name it: "ArrowUp".
        """
        with self._lock:
            self._holds[name] = _Hold(key)

    def DeleteHold(self, name: str, strict: bool = True) -> bool:
        """Deletes such a button.

        Raises:
            KeyError: there is none of that name, and `strict`.
        """
        with self._lock:
            return _delete(self._holds, name, strict)

    def GetHoldNames(self) -> list[str]:
        """Names of these buttons."""
        with self._lock:
            return list(self._holds)

    def IsHeld(self, name: str) -> bool:
        """Whether it is held now.

        Raises:
            KeyError: there is none of that name.
        """
        with self._lock:
            return time.monotonic() < self._holds[name].until

    # Meshcat's names.

    def AddButton(self, name: str) -> None:
        """Adds a button, or forgets its clicks where it is there."""
        with self._lock:
            self._buttons[name] = 0

    def DeleteButton(self, name: str, strict: bool = True) -> bool:
        """Deletes a button.

        Raises:
            KeyError: there is none of that name, and `strict`.
        """
        with self._lock:
            return _delete(self._buttons, name, strict)

    def GetButtonClicks(self, name: str) -> int:
        """Number of clicks on a button.

        Raises:
            KeyError: there is none of that name.
        """
        with self._lock:
            return self._buttons[name]

    def GetButtonNames(self) -> list[str]:
        """Names of the buttons."""
        with self._lock:
            return list(self._buttons)

    def AddSlider(
        self,
        name: str,
        min: float,  # noqa: A002
        max: float,  # noqa: A002
        step: float,
        value: float,
    ) -> None:
        """Adds a slider.

        Args:
            name: name of the slider, with the unit.
            min: smallest value.
            max: largest value.
            step: between two values.
            value: at first.

        Raises:
            ValueError: there is one of that name, or no step fits the range.
        """
        if not (min < max and step > 0.0):
            raise ValueError(f"a slider from {min} to {max} in steps of {step} has no values")
        with self._lock:
            if name in self._sliders:
                raise ValueError(f"there is a slider named {name!r}")
            slider = _Slider(name, min, max, step, value)
            slider.put(value)
            self._sliders[name] = slider

    def DeleteSlider(self, name: str, strict: bool = True) -> bool:
        """Deletes a slider.

        Raises:
            KeyError: there is none of that name, and `strict`.
        """
        with self._lock:
            return _delete(self._sliders, name, strict)

    def GetSliderNames(self) -> list[str]:
        """Names of the sliders."""
        with self._lock:
            return list(self._sliders)

    def GetSliderValue(self, name: str) -> float:
        """Value of a slider.

        Raises:
            KeyError: there is none of that name.
        """
        with self._lock:
            return self._sliders[name].value

    def SetSliderValue(self, name: str, value: float) -> float:
        """Moves a slider to the value of the step that is nearest; returns that value.

        Raises:
            KeyError: there is none of that name.
        """
        with self._lock:
            slider = self._sliders[name]
            slider.put(value)
            slider.sets += 1
            return slider.value

    def SetSliderRange(self, name: str, min: float, max: float) -> None:  # noqa: A002
        """Gives a slider another range; a value beyond it goes to its end.

        Raises:
            KeyError: there is none of that name.
            ValueError: the range is empty.
        """
        if min > max:
            raise ValueError(f"a slider from {min} to {max} has no values")
        with self._lock:
            slider = self._sliders[name]
            slider.low, slider.high = min, max
            if not min <= slider.value <= max:
                slider.put(slider.value)
                slider.sets += 1

    # What browsers ask for.

    def _state(self, page: str = "") -> dict[str, Any]:
        with self._lock:
            operates = self._hear(page)
            readout = asdict(self._readout)
            for row in readout["rows"]:
                for key in ("asked", "measured", "true"):
                    if row[key] is not None and not math.isfinite(row[key]):
                        row[key] = None  # JSON has no NaN
            return {
                "run": self._run,
                **readout,
                "sliders": [asdict(slider) for slider in self._sliders.values()],
                "buttons": list(self._buttons),
                "holds": [{"name": name, "key": hold.key} for name, hold in self._holds.items()],
                "operates": operates,
                "chart": self._charts if self._chart is not None else 0,
            }

    def _samples(self, number: str) -> dict[str, Any]:
        with self._lock:
            chart = self._chart
        if chart is None:
            return {}
        if not number.isdecimal():
            return {**chart.description}
        return chart.since(int(number))

    def _beat(self, page: str) -> None:
        with self._lock:
            self._hear(page)

    def _hear(self, page: str, takes_over: bool = False) -> bool:
        """Notes that a page speaks; whether it is the one that operates."""
        now = time.monotonic()
        if page == self._operator or takes_over or now - self._heard > _LEASE:
            self._operator, self._heard = page, now
            return True
        return False

    def _obey(self, request: Any) -> bool:
        """Moves a slider or counts a click; False where there is no such thing."""
        page = request.get("page", "") if isinstance(request, dict) else ""
        with self._lock:
            if not self._hear(str(page), request == {"page": page, "take_over": True}):
                return False
        match request:
            case {"take_over": True}:
                return True
            case {"hold": str(name), "on": bool() as is_held, "number": int() as number}:
                with self._lock:
                    if name not in self._holds:
                        return False
                    self._holds[name].hear(is_held, number)
                return True
            case {"slider": str(name), "value": float() | int() as value}:
                with self._lock:
                    slider = self._sliders.get(name)
                    if slider is None or not math.isfinite(value):
                        return False
                    slider.put(float(value))
                return True
            case {"button": str(name)}:
                with self._lock:
                    if name not in self._buttons:
                        return False
                    self._buttons[name] += 1
                return True
        return False


def _delete(things: dict[str, Any], name: str, strict: bool) -> bool:
    if strict and name not in things:
        raise KeyError(name)
    return things.pop(name, None) is not None


def _serve(owner: Panel) -> ThreadingHTTPServer:
    class Handler(_Handler):
        panel = owner

    address = "127.0.0.1" if owner._host == _LOCAL else owner._host
    for port in PORTS:
        try:
            return ThreadingHTTPServer((address, port), Handler)
        except OSError as error:
            last_error = error
    raise OSError(f"no port of {PORTS[0]}..{PORTS[-1]} is free on this computer") from last_error


class _Handler(BaseHTTPRequestHandler):
    """Answers who has the token, and obeys pages of this panel alone."""

    panel: Panel

    def do_GET(self) -> None:
        url = urlsplit(self.path)
        query = parse_qs(url.query)
        if not self._is_admitted():
            self._answer(HTTPStatus.FORBIDDEN)
        elif url.path == "/":
            self._answer(HTTPStatus.OK, "text/html; charset=utf-8", self.panel._page)
        elif url.path == "/beat":
            self.panel._beat(query.get("page", [""])[0])
            self._answer(HTTPStatus.NO_CONTENT)
        elif url.path == "/state":
            self._tell(self.panel._state(query.get("page", [""])[0]))
        elif url.path == "/samples":
            self._tell(self.panel._samples(query.get("since", [""])[0]))
        elif url.path == "/plotly.js" and self.panel._samples(""):
            self._answer(HTTPStatus.OK, "text/javascript; charset=utf-8", library().encode())
        else:
            self._answer(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        try:
            size = int(self.headers.get("Content-Length", ""))
        except ValueError:
            size = -1
        if not (self._is_admitted() and self._is_own_page()):
            self._answer(HTTPStatus.FORBIDDEN)
        elif not 0 <= size <= _LONGEST_REQUEST:
            self._answer(HTTPStatus.BAD_REQUEST)
        else:
            try:
                request = json.loads(self.rfile.read(size))
            except ValueError:
                request = None
            is_done = self.panel._obey(request)
            self._answer(HTTPStatus.NO_CONTENT if is_done else HTTPStatus.BAD_REQUEST)

    def _is_admitted(self) -> bool:
        """Whether who asks has the token.

        A page of this computer alone must also be asked for by its name, not by a stranger's.
        The token is in the address: a browser would show a cookie to all servers of this computer.
        """
        if self.panel._host == _LOCAL:
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
            if host not in (_LOCAL, "127.0.0.1"):
                return False
        (token,) = parse_qs(urlsplit(self.path).query).get("token", [""])[:1]
        return hmac.compare_digest(token.encode(), _TOKEN.encode())

    def _is_own_page(self) -> bool:
        """Whether what a browser sends is from the panel's page, not from another one."""
        origin = self.headers.get("Origin")
        return origin is not None and urlsplit(origin).netloc == self.headers.get("Host")

    def _tell(self, content: Any) -> None:
        self._answer(HTTPStatus.OK, "application/json", json.dumps(content).encode())

    def _answer(self, status: HTTPStatus, kind: str = "text/plain", body: bytes = b"") -> None:
        try:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            self.wfile.write(body)
        except ConnectionError:
            pass  # the page has been closed

    def log_message(self, *_: Any) -> None:
        """Says nothing: a terminal tells of the run."""


def _page(title: str, meshcat: Meshcat) -> bytes:
    from jinja2 import Environment, PackageLoader  # for a page only: most programs show none

    loader = PackageLoader("parapod.sims.lab", ".")
    template = Environment(loader=loader, autoescape=True).get_template("panel.html.jinja")
    port = urlsplit(meshcat.web_url()).port
    return template.render(title=title, meshcat_port=port).encode()
