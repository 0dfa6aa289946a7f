"""CiA 402 drives of several makers: settings, devices, and an emulator of them."""
