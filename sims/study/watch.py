"""A study that is looked at while it runs: its page in a browser, drawn anew as runs are done."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

from parapod.sims.lab.serve import PageServer
from parapod.sims.study.page import make_page
from parapod.sims.study.records import Records
from parapod.sims.study.result import StudyResult
from parapod.sims.study.study import Study

# Time between two looks of a browser at the page [s].
_PERIOD = 2
# Drawing takes at most this share of the time of the program that sends the runs out.
_SHARE = 0.2


@contextmanager
def watched(study: Study, records: Records, console: Console) -> Iterator[Callable[[], None]]:
    """Serves a study's page while it runs; in the end the whole one, until Ctrl-C.

    Args:
        study: the study.
        records: its records, which grow.
        console: console for the address.

    Yields:
        Function to call whenever runs are done.

    Raises:
        OutputError: no port is free for the page.
    """
    with PageServer(_page(study, records, _PERIOD)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        _say(console, f"the study is shown at {server.url}")
        due = time.monotonic() + _PERIOD

        def look() -> None:
            nonlocal due
            began = time.monotonic()
            if began >= due:
                server.page = _page(study, records, _PERIOD).encode()
                ended = time.monotonic()
                due = ended + max(_PERIOD, (ended - began) / _SHARE)

        try:
            yield look
            server.page = _page(study, records).encode()
            _say(console, f"the whole study stays at {server.url}; Ctrl-C ends")
            thread.join()
        except KeyboardInterrupt:
            if not records.done.all():
                raise
        finally:
            server.shutdown()


def _page(study: Study, records: Records, refresh: int = 0) -> str:
    result = StudyResult(study, records)
    return make_page(study, result.summary, result.figures, refresh=refresh)


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
