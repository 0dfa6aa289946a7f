"""The machining centres: bodies, loops, clamps, and a bench for them."""
