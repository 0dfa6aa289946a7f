"""Sabertooth motor drivers on a serial line: settings, device, and an emulator of them."""
