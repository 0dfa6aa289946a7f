import threading
import time

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff


def _fix(system, context, **inputs):
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)


def _read(system, context):
    ports = [system.get_output_port(i) for i in range(system.num_output_ports())]
    return {port.get_name(): np.array(port.Eval(context)) for port in ports}


@pytest.fixture
def fix():
    """fix(system, context, **inputs) sets input ports by name."""
    return _fix


@pytest.fixture
def read():
    """read(system, context) gives the values of all output ports by name."""
    return _read


@pytest.fixture
def moved():
    """moved(system, context, change) names the outputs that calling `change` moves."""

    def names(system, context, change):
        before = _read(system, context)
        change()
        after = _read(system, context)
        return {name for name in before if not np.array_equal(before[name], after[name])}

    return names


@pytest.fixture
def assert_gradient_agrees():
    """Compares AutoDiffXd of `evaluate(system, x)` at x with central differences of floats."""

    def check(system, evaluate, x, step=1e-6, tolerance=1e-6):
        x = np.asarray(x, dtype=float)
        converted = system.ToAutoDiffXd()
        exact = ExtractGradient(evaluate(converted, InitializeAutoDiff(x).flatten()))
        columns = []
        for i in range(x.size):
            ahead, behind = x.copy(), x.copy()
            ahead[i] += step
            behind[i] -= step
            columns.append((evaluate(system, ahead) - evaluate(system, behind)) / (2.0 * step))
        differences = np.stack(columns, axis=-1)
        scale = max(1.0, np.abs(differences).max())
        np.testing.assert_allclose(exact, differences, rtol=0.0, atol=tolerance * scale)
        assert np.abs(exact).max() > 0.0

    return check


class Judge:
    """Measures how long something takes, and by how much the machine was late meanwhile."""

    TICK = 5e-3

    def __enter__(self):
        self._ended, self.late = threading.Event(), 0.0
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        self._began = time.monotonic()
        return self

    def _watch(self):
        while not self._ended.is_set():
            before = time.monotonic()
            time.sleep(self.TICK)
            self.late += max(0.0, time.monotonic() - before - 2.0 * self.TICK)

    def __exit__(self, *_):
        self.took = time.monotonic() - self._began
        self._ended.set()
        self._thread.join()

    def check(self, limit):
        """Proves that it took no longer [s], or skips with what the machine managed."""
        if self.took > limit and self.took - self.late <= limit:
            pytest.skip(f"took {self.took:.3f} s; the machine was late by {self.late:.3f} s")
        assert self.took <= limit

    def check_at_least(self, value, least):
        """Proves that a value is large enough, or skips where the machine was often late."""
        if value < least and self.late > 0.1 * self.took:
            pytest.skip(f"{value:.3g} < {least:.3g}; the machine was late by {self.late:.3f} s")
        assert value >= least


@pytest.fixture
def judge():
    """`with judge() as judged: ...` and then `judged.check(limit)`: see `Judge`."""
    return Judge
