"""Answers of a person, or of another program by a file, while a machine waits in real time.

A loop in real time asks and looks for the answer at each tick; the waiting is done by a thread.
"""

import csv
import os
import queue
import select
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import quoted_path

# Interval at which a reader looks for an answer, or for the end of the questions [s].
_PAUSE = 0.2
_PIECE = 4096  # read at once [bytes]
# Column with the number of the question that a row answers.
NUMBER = "pose"


class NoAnswer(ParapodError):
    """The source of the answers has ended."""


class Answers(ABC):
    """Asks, and returns an answer once there is one."""

    def __init__(self, console: Console):
        """Prepares it; nothing is asked before `open` is entered.

        Args:
            console: console for the questions.
        """
        self._console = console
        self._answers: queue.Queue[str | None] = queue.Queue()
        self._over = threading.Event()

    @contextmanager
    def open(self) -> Iterator[None]:
        """While it lasts, answers are taken."""
        thread = threading.Thread(target=self._listen, name="answers", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            thread.join()

    def ask(self, number: int, question: str) -> None:
        """Asks.

        Args:
            number: number of the question, from 1 on.
            question: one line.
        """
        self.say(question)

    def say(self, text: str) -> None:
        """Prints a remark."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def take(self) -> str | None:
        """The next answer, as numbers with blanks between them; None while there is none.

        Raises:
            NoAnswer: there will be none.
        """
        try:
            answer = self._answers.get_nowait()
        except queue.Empty:
            return None
        if answer is None:
            raise NoAnswer("standard input has ended, so that no answers can arrive any more")
        return answer

    @abstractmethod
    def _listen(self) -> None:
        """Puts answers into the queue until no more are wanted."""


class ConsoleAnswers(Answers):
    """A person answers, a line a question."""

    def __init__(self, console: Console, descriptor: int = 0):
        """Prepares it.

        Args:
            console: console for the questions.
            descriptor: file that is read; standard input.
        """
        super().__init__(console)
        self._descriptor = descriptor

    def _listen(self) -> None:
        # Not the stream, whose lock a thread that waits would keep beyond the program's end.
        rest = b""
        while not self._over.is_set():
            if not select.select([self._descriptor], [], [], _PAUSE)[0]:
                continue
            piece = os.read(self._descriptor, _PIECE)
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                if text := line.decode(errors="replace").replace(",", " ").strip():
                    self._answers.put(text)
            if not piece:
                self._answers.put(None)
                return


class FileAnswers(Answers):
    """Rows of a CSV file, which another program may still be writing, a row a question.

    The first row names the columns, of which those that are needed are taken. A row is that of
    the question whose number stands in the column `pose`; without that column rows are counted.
    """

    def __init__(self, console: Console, path: Path, columns: Sequence[str]):
        """Prepares it.

        Args:
            console: console for the questions.
            path: the file; need not be there yet.
            columns: names of the columns that are needed.
        """
        super().__init__(console)
        self._path, self._columns = path, tuple(columns)
        self._wanted, self._taken = 0, ""

    def ask(self, number: int, question: str) -> None:
        """Asks; see `Answers`. The same number once more waits for another row."""
        super().ask(number, f"{question} (waits for row {number} of {quoted_path(self._path)})")
        if number != self._wanted:
            self._taken = ""
        self._wanted = number

    def _listen(self) -> None:
        while not self._over.wait(_PAUSE):
            questions = self._wanted
            if questions and (row := self._row(questions)) and row != self._taken:
                self._taken = row
                self._answers.put(row)

    def _row(self, number: int) -> str:
        """The row of a question; empty while there is none."""
        try:
            # A line is whole once its end is there.
            text = self._path.read_text(encoding="utf-8-sig", errors="replace")
        except OSError:
            return ""
        rows = list(csv.DictReader(text[: text.rfind("\n") + 1].splitlines()))
        for i, row in enumerate(rows, start=1):
            stated = row.get(NUMBER)
            if (str(i) if stated is None else stated.strip()) == str(number):
                return " ".join((row.get(name) or "?").strip() for name in self._columns)
        return ""
