"""Entries and process data that settings mean for drives, and settings that none can have."""

from collections.abc import Iterator

from parapod.systems.hardware.canopen import MASTER_ID, Entry, Pdo
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.makers import MAKERS
from parapod.systems.hardware.cia402.objects import Mode
from parapod.systems.hardware.cia402.settings import AxesSettings, Control
from parapod.systems.hardware.cia402.switches import check_switches
from parapod.systems.hardware.soft_limits import check_order


def set_up_of(settings: AxesSettings, rated: float = 1000.0) -> Iterator[tuple[Entry, int]]:
    """Entries that a drive must have before it may be enabled, in order.

    Its motor has a `rated` current [mA].
    """
    maker, mode = MAKERS[settings.drive], mode_of(settings)
    per_rpm = maker.per_rpm(settings.counts_per_turn)
    fastest, per_unit = settings.rpm(settings.max_velocity), settings.rpm_per_unit * per_rpm
    yield from maker.fixed
    yield objects.MODE, mode.number
    for entry in maker.speed_limits.get(settings.control, ()):
        yield entry, round(fastest if entry == objects.MAX_MOTOR_VELOCITY else fastest * per_rpm)
    if mode is objects.PROFILE_VELOCITY:
        yield objects.PROFILE_TYPE, 0
        yield objects.ACCELERATION, max(1, round(settings.acceleration * per_unit))
        yield objects.DECELERATION, max(1, round(settings.acceleration * per_unit))
    if settings.control is not Control.POSITION:
        yield mode.setting, 0
        if mode is objects.CYCLIC_TORQUE:
            yield objects.DISABLE_OPTION, objects.DISABLE_FREELY
    elif mode.number == objects.CYCLIC_POSITION.number:
        yield objects.PERIOD, settings.command_period_ms
        yield objects.PERIOD_EXPONENT, -3
    if settings.following_error is not None:
        yield objects.MAX_FOLLOWING_ERROR, round(settings.counts(settings.following_error))
    quick_stop = max(1, round(settings.quick_stop_deceleration * per_unit))
    yield objects.QUICK_STOP_DECELERATION, quick_stop
    if settings.has("current_limit_a"):
        unit = 1000.0 / rated if maker.is_relative else 1.0
        yield maker.current_limit, round(1e3 * settings.current_limit_a * unit)
    yield objects.ABORT_CONNECTION, objects.ABORT_BY_QUICK_STOP


def mode_of(settings: AxesSettings) -> Mode:
    """Mode of operation of the drives.

    Raises:
        ValueError: they do not have the settings' mode.
    """
    return MAKERS[settings.drive].mode(settings.control, settings.mode)


def outputs_pdo(settings: AxesSettings) -> Pdo:
    """Process data of digital outputs, which are switched while the axes are braked as well."""
    return objects.received(3, MAKERS[settings.drive].outputs.state)


def process_data(settings: AxesSettings, node_id: int) -> tuple[Pdo, ...]:
    """All process data of a node: what it obeys, and with what it answers SYNC."""
    mode = mode_of(settings)
    outputs = (outputs_pdo(settings),) if settings.outputs_of(node_id) else ()
    return (mode.command, mode.target, *outputs, *reports(settings, node_id))


def reports(settings: AxesSettings, node_id: int) -> tuple[Pdo, ...]:
    """Process data with which a node answers SYNC: two bytes cost less in a frame than one."""
    maker = MAKERS[settings.drive]
    inputs = [maker.inputs.state] if settings.inputs_of(node_id) else []
    current = [maker.current] if settings.measures_current else []
    motion = (objects.STATUSWORD, objects.POSITION, *inputs, objects.VELOCITY)
    return objects.sent([*motion, *current])


def check(settings: AxesSettings, heartbeat_period: float) -> None:
    """Refuses settings that do not fit together, or not the drives.

    Args:
        settings: settings of the axes.
        heartbeat_period: least time between two heartbeats of this computer [s].

    Raises:
        ValueError: in words that name the keys.
    """
    ids = (*settings.node_ids, MASTER_ID)
    if len(set(ids)) != len(ids) or len(ids) < 2 or not all(1 <= i <= 127 for i in ids):
        raise ValueError(f"node ids must be different ones of 1..127, not {ids}")
    if settings.heartbeat_timeout < 2.0 * heartbeat_period:
        raise ValueError(
            f"heartbeat_timeout must be two periods ({heartbeat_period} s) or more, "
            f"not {settings.heartbeat_timeout} s"
        )
    axes = len(settings.node_ids)
    if len(settings.directions) != axes or set(settings.directions) - {1, -1}:
        raise ValueError(f"signs must be {axes} times 1 or -1, not {settings.directions}")
    start, limits = settings.position_at_start, settings.limits
    strokes = None if settings.control is Control.VELOCITY else settings.strokes
    if settings.stop_node is not None and settings.stop_node not in settings.node_ids:
        raise ValueError(
            f"stop_node must be one of the node_ids or null, not {settings.stop_node}"
        )
    if start is not None and len(start) != axes:
        raise ValueError(f"position_at_start must be {axes} values, not {start}")
    if strokes is not None:
        check_order(*strokes)
    for lower in (limits and limits.lower, strokes and strokes[0]):
        if lower and len(lower) != axes:
            raise ValueError(f"limits must be {axes}, not {len(lower)}")
    mode, maker, home = mode_of(settings), MAKERS[settings.drive], settings.position_at_home
    if settings.homing_method is not None and (home is None or len(home) != axes):
        raise ValueError(
            f"with homing_method position_at_home_mm must be {axes} values, not {home}"
        )
    if settings.feedforward and mode.offset is None:
        raise ValueError(f"feedforward must be 0 with mode {mode.number} of {maker.name}")
    for each in settings.node_ids:
        inputs, outputs = settings.inputs_of(each), settings.outputs_of(each)
        pins = ("inputs", inputs, maker.inputs.bits), ("outputs", outputs, maker.outputs.bits)
        for what, numbers, bits in pins:
            if (number := max(numbers, default=0)) > len(bits):
                raise ValueError(
                    f"digital {what} of {maker.name} are 1..{len(bits)}, not {number}"
                )
    node, stop = settings.stop_node, settings.stop_input
    inputs_taken = {} if node is None else {(node, stop): "stop_input"}
    check_switches(settings.switches, settings.node_ids, inputs_taken)
