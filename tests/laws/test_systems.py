"""Laws of every system that `parapod.systems` defines; `conftest.py` finds and makes them."""

import inspect
import math
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem, PortDataType

import parapod
from parapod.diagrams.rows import RowsSimulator
from parapod.systems.core.errors import ParapodError

DOCS = Path(__file__).parents[2] / "docs"
SNAKE = re.compile(r"[a-z][a-z0-9_]*")
HAS_NO_PORTS_OF_ITS_OWN = "FunctionSystem"  # nor a name: they are its arguments
_DIAGRAMS = ("VelocityServo", "PositionServo", "PiServo", "TerrainReference")


def differing(first, second):
    """Keys of values that are not the same to the last bit."""
    return {key for key in first if not np.array_equal(first[key], second[key], equal_nan=True)}


# --- What people read


def test_systems_are_found(system_kind):
    assert issubclass(system_kind.type, LeafSystem) or system_kind.name in _DIAGRAMS
    assert system_kind.type.__module__.startswith("parapod.systems.")


def test_the_port_table_lists_the_declared_ports(system_kind):
    """In their order, with size, unit and meaning; and the text tells state or bad input."""
    first, second, *_ = lines = system_kind.text.splitlines()
    assert first.endswith(".")
    assert not second.strip()
    assert re.search(r"\b(Bad input|[Ss]tate)\b", system_kind.text)
    table = [line.strip() for line in lines if line.strip().startswith("|")]
    assert table[:2] == ["| port | size | unit | meaning |", "|---|---|---|---|"]
    if system_kind.name == HAS_NO_PORTS_OF_ITS_OWN:
        return
    assert len(system_kind.rows) == len(table) - 2, "a row is malformed"
    assert all(unit and len(meaning) > 3 for *_, unit, meaning in system_kind.rows)
    specimen = system_kind.specimens[0]
    for side, ports in (("in", specimen.inputs), ("out", specimen.outputs)):
        sizes = {port: size for way, port, size, *_ in system_kind.rows if way == side}
        assert list(sizes) == list(ports)
        for name, size in sizes.items():
            if size != "abstract" and not re.fullmatch(r"\d*[a-z]", size):
                assert int(size) == ports[name].size()
            assert (size == "abstract") == (ports[name].size() == 0)


def test_a_system_tells_its_name_and_its_arguments(system_kind):
    specimen = system_kind.specimens[0]
    if system_kind.name != HAS_NO_PORTS_OF_ITS_OWN:
        assert SNAKE.fullmatch(specimen.system.get_name())
    assert all(map(SNAKE.fullmatch, (*specimen.inputs, *specimen.outputs)))
    assert re.search(rf"\b{system_kind.name}\b", repr(specimen.system))
    parameters = inspect.signature(system_kind.type).parameters
    assert "converter" not in parameters
    for parameter in parameters.values():
        assert parameter.kind is parameter.POSITIONAL_OR_KEYWORD
        assert parameter.annotation is not parameter.empty, parameter.name


def test_updates_have_the_period_that_is_asked_for(system_kind):
    """That is the argument `period` or `time_step`."""
    parameters = inspect.signature(system_kind.type).parameters
    times = [argument for argument in ("time_step", "period") if argument in parameters]
    for period in (0.004, 0.25):
        system = system_kind.make(**{times[-1]: period} if times else {})
        event = system.GetUniquePeriodicDiscreteUpdateAttribute()
        if event is None:
            # What has no state may need the period of those who sample it.
            assert system.CreateDefaultContext().is_stateless()
        else:
            wanted = system_kind.entry.period(system) if system_kind.entry.period else period
            assert (event.period_sec(), event.offset_sec()) == (wanted, 0.0)


# --- What a system may depend on


def test_outputs_and_updates_are_functions_of_the_context(specimen):
    """Whatever else was evaluated before, in whatever order, here or in another context."""
    for context, random in specimen.moments():
        shown, ahead = specimen.shown(context), specimen.ahead(context)
        state = context.get_discrete_state()
        before = {i: state.value(i).copy() for i in range(state.num_groups())}
        other = specimen.system.CreateDefaultContext()
        specimen.fix(other, specimen.sample(random))
        specimen.step(other)
        specimen.all_of(other)
        fresh = context.Clone()
        fresh.SetAllCacheEntriesOutOfDate()
        assert differing(ahead, specimen.ahead(fresh)) == set()
        assert differing(shown, specimen.shown(fresh, order=-1)) == set()
        after = {i: state.value(i) for i in before}
        assert differing(before, after) == set(), "an update has changed its own context"


def test_two_contexts_are_independent(specimen):
    random = np.random.default_rng(1)
    one, other = (specimen.system.CreateDefaultContext() for _ in range(2))
    given = specimen.sample(random)
    specimen.fix(one, given)
    specimen.fix(other, given)
    before = specimen.all_of(one)
    for _ in range(3):
        specimen.step(other)
        specimen.fix(other, specimen.sample(random, enable=1.0))
        specimen.all_of(other)
    one.SetAllCacheEntriesOutOfDate()
    assert differing(before, specimen.all_of(one)) == set()


def test_whatever_changes_what_is_shown_follows(specimen):
    """A value that was calculated before a change is not shown after it."""
    for context, random in specimen.moments():
        for change in changes(specimen, context, random):
            specimen.all_of(context)
            change()
            cached = specimen.all_of(context)
            context.SetAllCacheEntriesOutOfDate()
            assert differing(cached, specimen.all_of(context)) == set()


def changes(specimen, context, random):
    """Calls that each change an input, a parameter, a group of the state, or the time."""
    for port, value in specimen.sample(random).items():
        yield lambda port=port, value=value: specimen.fix(context, {port: value})
    if isinstance(specimen.system, LeafSystem):
        for i in range(context.num_numeric_parameter_groups()):
            yield lambda i=i: _change(context.get_mutable_numeric_parameter(i))
        # As after an update that has taken place elsewhere, one group at a time.
        elsewhere = context.Clone()
        for _ in range(2):
            specimen.fix(elsewhere, specimen.sample(random, enable=1.0, brake=0.0))
            specimen.step(elsewhere)
        for i in range(context.num_discrete_state_groups()):
            value = elsewhere.get_discrete_state(i).value().copy()
            yield lambda i=i, value=value: context.SetDiscreteState(i, value)
    yield lambda: context.SetTime(context.get_time() + 0.013)


def _change(vector):
    value = vector.value()
    # A seed is a whole number.
    is_whole = (value % 1.0 == 0.0).all()
    vector.SetFromVector(value + 1.0 if is_whole else 1.01 * value)


def test_an_input_moves_at_once_what_it_is_said_to_move_and_nothing_else(system_kind):
    """Declared direct feedthrough is what a change of an input can do, in some variant."""
    declared, moved = set(), set()
    for specimen in system_kind.specimens:
        allowed = {
            (i, j)
            for i, port in specimen.inputs.items()
            for j, output in specimen.outputs.items()
            if specimen.system.HasDirectFeedthrough(port.get_index(), output.get_index())
        }
        declared |= allowed
        for context, random in specimen.moments(12):
            for port, value in specimen.sample(random).items():
                before = specimen.shown(context)
                specimen.fix(context, {port: value})
                context.SetAllCacheEntriesOutOfDate()
                found = {(port, name) for name in differing(before, specimen.shown(context))}
                assert found <= allowed
                moved |= found
    if system_kind.entry.shares:
        declared, moved = ({port for port, _ in pairs} for pairs in (declared, moved))
    assert moved == declared


# --- Inputs that are bad, or missing


def test_whatever_comes_in_the_outputs_said_to_pass_it_do_and_no_others(system_kind):
    """All others stay finite, and inside their limits."""
    entry = system_kind.entry
    said = {name for names in entry.passes.values() for name in names.split()}
    text = " ".join(system_kind.text.split())
    assert all(words in text for words in entry.passes)
    passed = set().union(*(passed_by(specimen) for specimen in system_kind.specimens))
    assert passed == said


def passed_by(specimen):
    """Outputs that are not finite after inputs that are bad."""
    begun = [context for context, _ in specimen.moments(4, seed=2)]
    random = np.random.default_rng(2)
    passed = set()
    for name, port in specimen.inputs.items():
        bads = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e6) if port.size() else ()
        for k, bad in enumerate(bads):
            for context in (moment.Clone() for moment in begun[k % 2 :: 2]):
                value = port.Eval(context).copy()
                # All of them, or one.
                where = slice(None) if random.random() < 0.5 else random.integers(port.size())
                value[where] = bad
                specimen.fix(context, {name: value})
                # What is calculated with such numbers overflows, and numpy may say so.
                with np.errstate(all="ignore"), suppress(*specimen.entry.raises):
                    for _ in range(4):
                        passed |= unbounded(specimen, context)
                        specimen.step(context)
    return passed


def unbounded(specimen, context):
    """Outputs that are not finite; those that are must keep to their limits."""
    values = specimen.shown(context)
    for name, limit in specimen.entry.limits.items():
        low, high = limit if isinstance(limit, tuple) else (-limit, limit)
        known = values[name][np.isfinite(values[name])]
        assert ((known >= low - 1e-9) & (known <= high + 1e-9)).all(), name
    return {name for name, value in values.items() if not np.isfinite(value).all()}


def test_an_input_that_need_not_be_connected_says_what_it_is_then(system_kind):
    """And every other one is needed by an output or an update, in some variant."""
    meanings = {port: meaning for way, port, _, _, meaning in system_kind.rows if way == "in"}
    optional = {port for port, text in meanings.items() if "unconnected" in text}
    unused = {port for port, text in meanings.items() if "not used" in text}
    needed = set()
    for specimen in system_kind.specimens:
        for k, (context, random) in enumerate(specimen.moments(80)):
            if k >= 12 and set(meanings) <= needed | optional | unused:
                break
            given = specimen.sample(random)
            for missing in given:
                partly = specimen.system.CreateDefaultContext()
                partly.SetTimeStateAndParametersFrom(context)
                specimen.fix(partly, {k: v for k, v in given.items() if k != missing})
                try:
                    without = specimen.all_of(partly)
                except RuntimeError:  # Drake's, which names the port
                    needed.add(missing)
                    continue
                if missing in optional:
                    value = float("unconnected: always" in meanings[missing])
                    specimen.fix(
                        partly, {missing: np.full(specimen.inputs[missing].size(), value)}
                    )
                    assert differing(without, specimen.all_of(partly)) == set()
    assert not needed & (optional | unused)
    if system_kind.name != HAS_NO_PORTS_OF_ITS_OWN:
        assert set(meanings) == needed | optional | unused


# --- Gradients


def test_the_systems_that_convert_are_those_made_from_templates(system_kind):
    converts = system_kind.make().ToAutoDiffXdMaybe() is not None
    assert converts == system_kind.is_template


@pytest.mark.parametrize("number", [1, 3, 5])
def test_gradients_agree_with_differences(convertible, number, assert_gradient_agrees):
    """Gradients of outputs and updates by inputs, state and parameters, all settings kept."""
    context = list(convertible.moments(6, seed=4))[number][0]
    given = {name: port.Eval(context).copy() for name, port in convertible.inputs.items()}
    switches = {name: given.pop(name) for name in ("enable", "stop") if name in given}
    state = [
        context.get_discrete_state(i).value().copy()
        for i in range(context.num_discrete_state_groups())
    ]
    parameters = [
        context.get_numeric_parameter(i).value().copy()
        for i in range(context.num_numeric_parameter_groups())
    ]
    values = [*given.values(), *state, *parameters]
    scale = np.concatenate([*map(np.ones_like, (*given.values(), *state)), *parameters])

    def evaluate(system, x):
        parts = iter(np.split(np.asarray(x) * scale, np.cumsum([v.size for v in values])[:-1]))
        context = system.CreateDefaultContext()
        for name, value in switches.items():
            system.GetInputPort(name).FixValue(context, value)
        for name in given:
            system.GetInputPort(name).FixValue(context, next(parts))
        for i in range(len(state)):
            context.SetDiscreteState(i, next(parts))
        for i in range(len(parameters)):
            context.get_mutable_numeric_parameter(i).SetFromVector(next(parts))
        outputs = [
            system.get_output_port(i).Eval(context) for i in range(system.num_output_ports())
        ]
        if state:
            ahead = system.EvalUniquePeriodicDiscreteUpdate(context)
            outputs += [ahead.value(i) for i in range(ahead.num_groups())]
        return np.concatenate(outputs)

    x = np.concatenate(values) / scale
    assert_gradient_agrees(convertible.system, evaluate, x)


# --- Beginning


def test_what_is_desired_begins_where_something_is_measured(system_kind):
    """While that moves, in a default context; and there is no jump at the first update."""
    if system_kind.entry.begins is None:
        return
    output, expected = system_kind.entry.begins
    specimen, random = system_kind.specimens[0], np.random.default_rng(6)
    context = specimen.system.CreateDefaultContext()
    for _ in range(3):
        given = specimen.sample(random, enable=1.0, posture_control=0.0)
        specimen.fix(context, given)
        shown = specimen.shown(context)[output]
        np.testing.assert_allclose(shown, expected(given), rtol=0.0, atol=1e-12)
    specimen.step(context)
    shown = specimen.shown(context)[output]
    np.testing.assert_allclose(shown, expected(given), rtol=0.0, atol=1e-4)


class Course(parapod.LeafSystem):
    """One value until a time, and then another one."""

    def __init__(self, size, turn):
        super().__init__()
        self._turn = turn
        values = [self.DeclareNumericParameter(BasicVector(size)) for _ in range(2)]
        self._values = values
        tickets = {self.time_ticket(), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("value", size, self._calc, tickets)

    def _calc(self, context, output):
        value = self._values[context.get_time() >= self._turn]
        output.SetFromVector(context.get_numeric_parameter(value).value())


def test_rows_of_a_system_are_its_runs(specimen):
    """Whatever comes in, row by row; one that fails does so in its run too, and alone."""
    system = specimen.kind.make(**specimen._arguments)
    update = system.GetUniquePeriodicDiscreteUpdateAttribute()
    period, offset = (0.1, 0.0) if update is None else (update.period_sec(), update.offset_sec())
    begin, turn, until = (offset + share * period for share in (2.5, 4.5, 7.5))
    builder = DiagramBuilder()
    builder.AddNamedSystem("system", system)
    courses = {}
    for name in specimen.inputs:
        port = system.GetInputPort(name)
        if port.get_data_type() == PortDataType.kAbstractValued:
            pytest.skip(f"'{name}' has no numbers")
        courses[name] = builder.AddNamedSystem(name, Course(port.size(), turn))
        builder.Connect(courses[name].get_output_port(), port)
    diagram = builder.Build()

    def steer(context, seed):
        samples = [specimen.sample(np.random.default_rng([seed, part])) for part in range(2)]
        for name, course in courses.items():
            own = course.GetMyMutableContextFromRoot(context)
            for part, sample in enumerate(samples):
                own.get_mutable_numeric_parameter(part).SetFromVector(sample[name])

    contexts = []
    for row in range(6):
        contexts.append(diagram.CreateDefaultContext())
        if row % 2:  # rows have pasts of their own
            steer(contexts[-1], 10 + row)
            with suppress(Exception):
                Simulator(diagram, contexts[-1]).AdvanceTo(begin)
        contexts[-1].SetTime(begin)
        steer(contexts[-1], row)
    try:
        rows = RowsSimulator(diagram, [(diagram, context) for context in contexts])
    except ParapodError as refusal:
        pytest.skip(str(refusal))
    rows.advance_to(until, until)
    for row, context in enumerate(contexts):
        simulator = Simulator(diagram, context)
        if row in rows.errors:
            with pytest.raises(type(rows.errors[row])):
                simulator.AdvanceTo(until)
            continue
        simulator.AdvanceTo(until)
        for name in specimen.outputs:
            port = system.GetOutputPort(name)
            if port.get_data_type() == PortDataType.kAbstractValued:
                continue
            expected = port.Eval(system.GetMyContextFromRoot(context))
            np.testing.assert_allclose(
                rows.value(system, name, row), expected, rtol=1e-12, atol=1e-15, err_msg=name
            )
