"""A person in front of the operator's page, for programs that operate a machine without one."""

import json
import threading
import time
import urllib.request
from typing import Any


class Page:
    """A person in front of a browser.

    Attributes:
        url: address of the page.
        is_open: whether the page says that it is there.
        held: name of the button that is held; "": none.
    """

    def __init__(self, url: str):
        self.url, self.is_open, self.held = url, threading.Event(), ""
        self.is_open.set()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def _speak(self) -> None:
        while not self._over.wait(0.05):
            if not self.is_open.is_set():
                continue
            try:
                urllib.request.urlopen(f"{self.url}/beat?page=me", timeout=2.0).close()
                if self.held:
                    self.send(hold=self.held, on=True, number=time.monotonic_ns())
            except OSError:
                return  # the program has ended

    def state(self) -> Any:
        """Everything that the page shows."""
        with urllib.request.urlopen(f"{self.url}/state?page=me", timeout=5.0) as answer:
            return json.loads(answer.read())

    def send(self, **body: Any) -> None:
        """Does something on the page."""
        data = json.dumps({"page": "me", **body}).encode()
        request = urllib.request.Request(self.url, data, {"Origin": self.url})
        urllib.request.urlopen(request, timeout=5.0).close()

    def click(self, name: str) -> None:
        """Clicks a button."""
        self.send(button=name)

    def wait(self, state: str, timeout: float = 30.0) -> float:
        """Waits until the machine is in a state; says for how long [s].

        Raises:
            TimeoutError: it is in another one; has what the page shows.
        """
        begun = time.monotonic()
        while (shown := self.state())["state"] != state:
            if time.monotonic() > begun + timeout:
                raise TimeoutError(shown)
            time.sleep(0.02)
        return time.monotonic() - begun

    def close(self) -> None:
        """Leaves."""
        self._over.set()
        self._thread.join()
