"""A multifunction card of National Instruments: settings, device, and an emulator of it."""

import os

# Or gRPC writes a line to the terminal whenever a server ends a connection, which the device tells
# by an error of its own. It is read once, when gRPC is loaded; another setting stays.
os.environ.setdefault("GRPC_VERBOSITY", "ERROR")
