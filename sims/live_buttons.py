"""Buttons in the browser for what goes on after a job."""

from collections.abc import Iterator
from contextlib import contextmanager

from pydrake.geometry import Meshcat

RESTART, STOP = "Restart", "Stop"


@contextmanager
def buttons(meshcat: Meshcat) -> Iterator[None]:
    """Shows the buttons while it lasts."""
    for name in (RESTART, STOP):
        meshcat.AddButton(name)
    try:
        yield
    finally:
        for name in (RESTART, STOP):
            meshcat.DeleteButton(name, strict=False)


def clicked(meshcat: Meshcat, button: str) -> bool:
    """Whether somebody has clicked a button since it was shown."""
    return meshcat.GetButtonClicks(button) > 0
