"""The default scenario of every experiment: `<experiment>.yaml`."""
