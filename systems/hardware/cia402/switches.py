"""Locks, clamps and other switches of a machine at the digital outputs of its drives.

Each has an output that opens it against a spring, and an input with a contact that is closed while
it is closed. So whatever is without power is closed, and a broken wire reads "not closed".
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

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


class LimbSwitches(NamedTuple):
    """Settings of a machine of limbs: four locks at the left leg's node, a clamp at the right's.

    Attributes:
        lock_nodes: node of each lock, those of limb 1 first.
        lock_outputs: output of each lock.
        lock_inputs: input of each lock's contact.
        clamp_nodes: node of each limb's clamp.
        clamp_outputs: output of each clamp.
        clamp_inputs: input of each clamp's contact.
        stop_node: node of the emergency stop's contact, the first right leg's.
        stop_input: its input.
    """

    lock_nodes: list[int]
    lock_outputs: list[int]
    lock_inputs: list[int]
    clamp_nodes: list[int]
    clamp_outputs: list[int]
    clamp_inputs: list[int]
    stop_node: int
    stop_input: int


def switches_of_limbs(limbs: int) -> LimbSwitches:
    """Settings for limbs whose legs are at nodes 1 (left), 2 (right), 3, 4, ...

    Args:
        limbs: number of limbs.
    """
    left, right = range(1, 2 * limbs, 2), range(2, 2 * limbs + 1, 2)
    locks = [*_LOCKS] * limbs
    nodes = [node for node in left for _ in _LOCKS]
    clamps = [_CLAMP] * limbs
    return LimbSwitches(nodes, locks, locks, [*right], clamps, clamps, right[0], _STOP)


def group(
    part: str, key: str, nodes: Sequence[int], outputs: Sequence[int], inputs: Sequence[int]
) -> SwitchGroup:
    """Switches of parallel lists.

    Args:
        part: part of the machine.
        key: beginning of the lists' names.
        nodes: node of each switch.
        outputs: output of each switch.
        inputs: input of each switch.

    Raises:
        ValueError: the lists are not of the same length.
    """
    sizes = (len(nodes), len(outputs), len(inputs))
    if len(set(sizes)) != 1:
        raise ValueError(
            f"{key}_nodes, {key}_outputs and {key}_inputs must be of the same length, not "
            f"{sizes[0]}, {sizes[1]} and {sizes[2]}"
        )
    switches = (Switch(*place) for place in zip(nodes, outputs, inputs, strict=True))
    return SwitchGroup(part, key, tuple(switches))


def check_switches(
    groups: Sequence[SwitchGroup],
    node_ids: Sequence[int],
    inputs_taken: Mapping[tuple[int, int], str],
) -> None:
    """Refuses switches that cannot be wired so.

    Args:
        groups: all groups of a device.
        node_ids: its nodes.
        inputs_taken: name of a further thing at an input, by (node, input).

    Raises:
        ValueError: an unknown node, or an output or input that is given twice.
    """
    outputs: dict[tuple[int, int], str] = {}
    inputs = dict(inputs_taken)
    for each in groups:
        for number, switch in enumerate(each.switches, start=1):
            if switch.node not in node_ids:
                raise ValueError(f"{each.key}_nodes must be of the node_ids, not {switch.node}")
            name = f"{each.part} {number}"
            for what, place, places_used in (
                ("output", switch.output, outputs),
                ("input", switch.input, inputs),
            ):
                other = places_used.setdefault((switch.node, place), name)
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
        """Creates a board on which all are closed.

        Args:
            groups: groups of switches.
        """
        self._groups = tuple(groups)
        self.measures = {each.measure: len(each.switches) for each in groups}
        self.commands = {each.command: len(each.switches) for each in groups}
        self._open: set[Switch] = set()

    def close_all(self) -> None:
        """From now on all are closed."""
        self._open.clear()

    def is_clear(self, commands: Mapping[str, Sequence[float]]) -> bool:
        """Whether commands say of each switch, if they say anything, that it is closed or open.

        Args:
            commands: commands of `obey`.
        """
        groups_of_values = (commands.get(each.command, ()) for each in self._groups)
        return all(switched(value) is not None for values in groups_of_values for value in values)

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
        """Signals of the contacts.

        Args:
            inputs: states of a node's inputs 1, 2, ..., by node: true where there is voltage.
        """
        for each in self._groups:
            closed = [float(inputs[node][number - 1]) for node, _, number in each.switches]
            yield each.measure, closed
