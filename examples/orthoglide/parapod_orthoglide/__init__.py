"""The Orthoglide: three drives at right angles and three legs carry a tool through a cube."""
