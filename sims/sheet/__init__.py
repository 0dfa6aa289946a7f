"""Data sheets of machines as they are set: closed forms, nothing simulated."""
