"""Maxon motors on EPOS2 24/5 controllers: settings, drives, and an emulator of them."""
