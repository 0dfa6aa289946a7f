import importlib
from concurrent.futures import Executor, Future

import pytest
from rich.console import Console

from parapod.sims.lab.work import Crew
from parapod.sims.study.records import Records
from parapod.sims.study.result import StudyResult
from parapod.sims.study.study import Study

TRIAL = '''"""Try a sum.

Nothing of it is random.
"""

import math
import os
import signal
import time
from dataclasses import dataclass

from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.schema import Schema, choice, quantity


@dataclass
class TrialScenario(Schema):
    """One trial.

    Attributes:
        backend: method.
        seed: seed.
        x: first number [mm].
        y: second number [mm].
        kind: what it does.
        note: any text.
        wait: time that it takes [s].
    """

    backend: str = choice("exact", ("exact", "hardware"))
    seed: int = quantity(0, 0, 10_000)
    x: float = quantity(0.0, -10.0, 10.0)
    y: float = quantity(0.0, -10.0, 10.0)
    kind: str = choice("good", ("good", "refused", "crash", "lethal", "endless"))
    note: str = ""
    wait: float = quantity(0.0, 0.0, 10.0)


class Trial(Experiment[TrialScenario, None]):
    """Tries it."""

    schema = TrialScenario
    backends = ("exact",)

    def run(self, scenario, bench):
        time.sleep(scenario.wait)
        if scenario.kind == "refused":
            raise ParapodError(f"x = {scenario.x:g} is refused")
        if scenario.kind == "crash":
            raise RuntimeError("it does\\nnot converge")
        if scenario.kind == "lethal":
            os.kill(os.getpid(), signal.SIGKILL)

    def measure(self, scenario, data):
        total = scenario.x + 2.0 * scenario.y
        value = total if scenario.kind == "good" else math.inf
        yield Metric("total_mm", value, "mm", 5.0, undefined="the sum is endless")
        yield Metric("floor_mm", scenario.y, "mm", at_least=-1.0)
        if scenario.x > 0.0:
            yield Metric("own_mm", scenario.x, "mm", 1.0 + abs(scenario.y), meaning="of its own")
        yield Metric("clock_s", time.perf_counter(), "s", 0.0, is_timing=True)
'''


class Here(Executor):
    """Carries everything out at once, in this process."""

    def submit(self, function, /, *arguments, **options):
        future = Future()
        try:
            future.set_result(function(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture
def trial(install):
    """An installed experiment, `trial`; the class of its scenarios."""
    points = "[parapod.experiments]\ntrial = trials.trial:Trial\n"
    install("trials", points, {"trials/__init__.py": '"""Trials."""\n', "trials/trial.py": TRIAL})
    return importlib.import_module("trials.trial").TrialScenario


@pytest.fixture
def study(trial):
    """Makes a study of it."""

    def make(vary, *sampling, **settings):
        return Study.make("trial", trial(**settings), vary, *sampling)

    return make


def carry_out(study, path=None, resume=False, crew=None, console=None):
    """Its result; by default everything is carried out in this process."""
    records = Records(study.sampling)
    console = console or Console(quiet=True)
    study.carry_out(crew or Crew(Here(), 1), records, console, path, resume)
    return StudyResult(study, records)
