"""Locks, clamps and other switches of a machine at the digital outputs of its drives.

Each has an output that opens it against a spring, and an input with a contact that is closed while
it is closed. So whatever is without power is closed, and a broken wire reads "not closed".
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from parapod.systems.core.switching import switched

# Numbers of a limb's outputs with its locks, and of its contact of the emergency stop.
_LOCKS, _CLAMP, _STOP = (1, 2, 3, 4), 1, 5


class Switch(NamedTuple):
    """Output and input of one lock or clamp.

    Attributes:
        node: address of the controller that both are at.
        output: number of the digital output, from 1; on: it opens.
        input: number of the digital input, from 1; voltage: it is closed.
    """

    node: int
    output: int
    input: int


class SwitchGroup(NamedTuple):
    """Switches that are elements of the same signals.

    Attributes:
        part: part of the machine, as in the names of its ports.
        key: beginning of its settings' names, as "lock" of `lock_nodes`.
        switches: the switches, in the order of the elements.
    """

    part: str
    key: str
    switches: tuple[Switch, ...]

    @property
    def measure(self) -> str:
        """Port that shows which of them are closed."""
        return f"{self.part}.closed"

    @property
    def command(self) -> str:
        """Port that closes and opens them."""
        return f"{self.part}.command"


def switches_of_limbs(limbs: int) -> dict[str, Any]:
    """Settings of a machine of limbs whose legs are at nodes 1 (left), 2 (right), 3, 4, ...

    Four locks are at each left leg's node, a clamp is at the right leg's, and the contact of the
    emergency stop at the first right leg's.

    Args:
        limbs: number of limbs.

    Returns:
        Keys of `PositionScrewSettings` and their values: lists with those of limb 1 first, and
        `stop_node` and `stop_input`.
    """
    left, right = range(1, 2 * limbs, 2), range(2, 2 * limbs + 1, 2)
    locks, clamps = [*_LOCKS] * limbs, [_CLAMP] * limbs
    return {
        "lock_nodes": [node for node in left for _ in _LOCKS],
        "lock_outputs": locks,
        "lock_inputs": locks,
        "clamp_nodes": [*right],
        "clamp_outputs": clamps,
        "clamp_inputs": clamps,
        "stop_node": right[0],
        "stop_input": _STOP,
    }


def group(
    part: str, key: str, nodes: Sequence[int], outputs: Sequence[int], inputs: Sequence[int]
) -> SwitchGroup:
    """Group of the switches that parallel lists describe: see `SwitchGroup` and `Switch`.

    Raises:
        ValueError: the lists are not of the same length.
    """
    if not len(nodes) == len(outputs) == len(inputs):
        raise ValueError(
            f"{key}_nodes, {key}_outputs and {key}_inputs must be of the same length, not "
            f"{len(nodes)}, {len(outputs)} and {len(inputs)}"
        )
    return SwitchGroup(part, key, tuple(map(Switch, nodes, outputs, inputs)))


def check_switches(
    groups: Sequence[SwitchGroup],
    node_ids: Sequence[int],
    inputs_taken: Mapping[tuple[int, int], str],
) -> None:
    """Refuses switches of a device that cannot be wired so.

    Args:
        groups: all groups of the device.
        node_ids: its nodes.
        inputs_taken: name of a further thing at an input, by (node, input).

    Raises:
        ValueError: an unknown node, or an output or input that is given twice.
    """
    names = {("input", *place): name for place, name in inputs_taken.items()}
    for each in groups:
        for number, switch in enumerate(each.switches, start=1):
            if switch.node not in node_ids:
                raise ValueError(f"{each.key}_nodes must be of the node_ids, not {switch.node}")
            name = f"{each.part} {number}"
            for what, place in (("output", switch.output), ("input", switch.input)):
                other = names.setdefault((what, switch.node, place), name)
                if other != name:
                    raise ValueError(
                        f"{what} {place} of node {switch.node} is given twice: {other} and {name}"
                    )


class SwitchBoard:
    """Commands and contacts of all switches of a device.

    A switch is closed until it is commanded open. A command that is near neither 0 nor 1 opens
    none, and closes one as soon as that breaks nothing.

    Attributes:
        measures: signals that show which are closed, and their sizes.
        commands: signals that close and open them, and their sizes.
    """

    def __init__(self, groups: Sequence[SwitchGroup]):
        """Creates a board of these groups, on which all switches are closed."""
        self._groups = tuple(groups)
        self.measures = {each.measure: len(each.switches) for each in groups}
        self.commands = {each.command: len(each.switches) for each in groups}
        self._open: set[Switch] = set()

    def close_all(self) -> None:
        """From now on all are closed."""
        self._open.clear()

    def is_clear(self, commands: Mapping[str, Sequence[float]]) -> bool:
        """Whether commands of `obey` say of each switch that they name: closed, or open."""
        values = (value for name in self.commands for value in commands.get(name, ()))
        return all(switched(value) is not None for value in values)

    def obey(self, commands: Mapping[str, Sequence[float]], may_open: bool, stands: bool) -> None:
        """Takes commands.

        Args:
            commands: signals; 1: closed, 0: open; the switches of one that is missing stay.
            may_open: true if a closed one may be opened.
            stands: true if nothing moves, so that closing a switch that was not commanded closed
                breaks nothing.
        """
        for each in self._groups:
            if each.command not in commands:
                continue
            for switch, value in zip(each.switches, commands[each.command], strict=True):
                is_closed = switched(value)
                if is_closed or (is_closed is None and stands):
                    self._open.discard(switch)
                elif is_closed is False and may_open:
                    self._open.add(switch)

    def outputs_on(self, node: int) -> set[int]:
        """Numbers of a node's outputs that are to be on."""
        return {switch.output for switch in self._open if switch.node == node}

    def measured(self, inputs: Mapping[int, Sequence[bool]]) -> Iterator[tuple[str, list[float]]]:
        """Signals of the contacts, by whether there is voltage at a node's inputs 1, 2, ..."""
        for each in self._groups:
            closed = [float(inputs[node][number - 1]) for node, _, number in each.switches]
            yield each.measure, closed
