"""A multifunction card of National Instruments: settings, device, and an emulator of it."""
