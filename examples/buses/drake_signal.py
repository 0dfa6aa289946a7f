"""Drake's message `lcmt_drake_signal`, for programs that have LCM alone: names, values, time."""

import struct

FINGERPRINT = bytes.fromhex("46dce7d9adf87264")


def encode(names, values, stamp):
    """A message of values by their names, at a time [s]."""
    texts = [name.encode() + b"\0" for name in names]
    coord = b"".join(struct.pack(">i", len(text)) + text for text in texts)
    numbers = struct.pack(f">i{len(values)}d", len(values), *values)
    return FINGERPRINT + numbers + coord + struct.pack(">q", round(1e6 * stamp))


def decode(data):
    """Values of a message by their names, and its time [s]."""
    if data[:8] != FINGERPRINT:
        raise ValueError("not a message of the type lcmt_drake_signal")
    (count,) = struct.unpack_from(">i", data, 8)
    values = struct.unpack_from(f">{count}d", data, 12)
    at, names = 12 + 8 * count, []
    for _ in range(count):
        (size,) = struct.unpack_from(">i", data, at)
        names.append(data[at + 4 : at + 3 + size].decode())
        at += 4 + size
    return dict(zip(names, values, strict=True)), 1e-6 * struct.unpack_from(">q", data, at)[0]
