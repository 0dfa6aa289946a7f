"""Any machine: questions put to every one that is installed."""
