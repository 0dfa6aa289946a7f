"""A network of the tests' own, in which messages to groups stay."""

import os
import subprocess
import threading

_SET_UP = (
    "ip link set lo up multicast on",
    "ip route add 224.0.0.0/4 dev lo",
)


def enter_own_network():
    """Leaves the computer's network for one of a loopback alone; says why if it cannot.

    Programs that this one begins are in it, too. Only a superuser may: a namespace of users, which
    others would need, changes what programs are permitted.
    """
    if not hasattr(os, "unshare"):
        return "the computer's: this system has no namespaces"
    if threading.active_count() > 1:
        return "the computer's: other threads run already"
    before = os.open("/proc/self/ns/net", os.O_RDONLY)
    try:
        os.unshare(os.CLONE_NEWNET)
        try:
            for line in _SET_UP:
                subprocess.run(line.split(), check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            os.setns(before)
            return "the computer's: nothing sets a loopback up"
    except OSError as error:
        return f"the computer's: no namespace of its own, {error.strerror}"
    finally:
        os.close(before)
    return ""
