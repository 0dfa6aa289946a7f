"""How much of a CAN bus a cycle of process data takes."""

from parapod.systems.hardware import epos2_objects as objects
from parapod.systems.hardware.epos2_setup import Epos2Params


def frame_bits(size: int) -> int:
    """The most bits that a data frame with an identifier of 11 bits takes (ISO 11898-1).

    With the pause after it, and with as many stuff bits as there can be: of the 34 + 8 n bits
    from its start to its checksum, every fourth but the first.

    Args:
        size: number of data bytes n.
    """
    return 47 + 8 * size + (33 + 8 * size) // 4


def bus_load(params: Epos2Params, period: float) -> float:
    """Share of the bus's time that synchronous reading and commanding takes at most [-].

    A cycle is SYNC, the frames of all nodes that answer it, and a command for each; besides,
    there is this computer's heartbeat. Emergencies, and service data at the beginning and the
    end, come to it.

    Args:
        params: of the drives and of the bus.
        period: of the cycle [s].
    """
    of_node = sum(frame_bits(pdo.size) for pdo in (objects.COMMAND, *params.reports))
    cycle = frame_bits(0) + len(params.node_ids) * of_node
    heartbeat = frame_bits(1) / max(period, params.heartbeat_period)
    return (cycle / period + heartbeat) / params.bitrate
