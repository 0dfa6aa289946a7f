"""Work of Drake's renderer in a process of its own, which a missing OpenGL would end."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool


def rendered[T](work: Callable[[], T]) -> T:
    """Result of work that needs the renderer.

    Args:
        work: a function of a module, or a `functools.partial` of one.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(work).result()
        except BrokenProcessPool:
            message = "Drake's renderer found no OpenGL through EGL (on Debian: libegl1)"
            raise RuntimeError(message) from None
