"""Buses that other programs speak: LCM, with the table of ports as its messages."""
