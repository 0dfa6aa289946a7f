"""Pictures that Drake's renderer takes, in a process of their own."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from parapod.sims.report.chapter import Picture


def rendered(take: Callable[[], tuple[Picture, ...]]) -> tuple[Picture, ...]:
    """Pictures that a function takes; without OpenGL the renderer ends its process.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(take).result()
        except BrokenProcessPool:
            message = "Drake's renderer found no OpenGL through EGL (on Debian: libegl1)"
            raise RuntimeError(message) from None
