"""The inertial sensor ADIS16448: settings, devices, and emulators of it."""
