"""Answers at the console and in a file, while a machine waits."""

import contextlib
import os
import time

import pytest
from rich.console import Console

from parapod.sims.real_machine.answers import ConsoleAnswers, FileAnswers, NoAnswer


def waited(answers, seconds=5.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if (answer := answers.take()) is not None:
            return answer
        time.sleep(0.01)
    return None


@pytest.fixture
def pipe():
    """Ends of a pipe: what is read, and what a person writes to."""
    reading, writing = os.pipe()
    yield reading, writing
    for end in (reading, writing):
        with contextlib.suppress(OSError):
            os.close(end)


def test_a_line_is_an_answer_and_blank_lines_are_none(pipe):
    answers = ConsoleAnswers(Console(quiet=True), pipe[0])
    with answers.open():
        assert answers.take() is None
        os.write(pipe[1], b"\n455.5, 0.6 -1\n4")
        assert waited(answers) == "455.5  0.6 -1"
        assert answers.take() is None  # the line is not whole
        os.write(pipe[1], b"60\n")
        assert waited(answers) == "460"


def test_a_console_that_ends_is_no_one_who_answers(pipe):
    answers = ConsoleAnswers(Console(quiet=True), pipe[0])
    with answers.open():
        os.close(pipe[1])
        with pytest.raises(NoAnswer, match="standard input has ended"):
            waited(answers)


def test_rows_of_a_file_are_answers_as_they_come(tmp_path):
    path = tmp_path / "tracker.csv"
    answers = FileAnswers(Console(quiet=True), path, ("height_mm", "roll_deg"))
    with answers.open():
        answers.ask(1, "?")
        assert waited(answers, 0.5) is None
        path.write_text("time,roll_deg,height_mm\n09:00,0.5,455\n09:05,0.7,46")
        assert waited(answers) == "455 0.5"
        answers.ask(2, "?")
        assert waited(answers, 0.5) is None  # its line is not whole
        path.write_text("time,roll_deg,height_mm\n09:00,0.5,455\n09:05,0.7,460\n")
        assert waited(answers) == "460 0.7"


def test_a_row_that_was_refused_is_waited_for_until_it_is_another_one(tmp_path):
    path = tmp_path / "tracker.csv"
    path.write_text("pose,height_mm\n2,460\n1,4x\n")
    answers = FileAnswers(Console(quiet=True), path, ("height_mm",))
    with answers.open():
        answers.ask(1, "?")
        assert waited(answers) == "4x"
        answers.ask(1, "?")
        assert waited(answers, 0.5) is None
        path.write_text("pose,height_mm\n2,460\n1,455\n")
        assert waited(answers) == "455"


def test_a_column_that_is_missing_is_no_number(tmp_path):
    path = tmp_path / "tracker.csv"
    path.write_text("pose,height_mm\n1,455\n")
    answers = FileAnswers(Console(quiet=True), path, ("height_mm", "roll_deg"))
    with answers.open():
        answers.ask(1, "?")
        assert waited(answers) == "455 ?"
