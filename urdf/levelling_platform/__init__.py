"""Models of the levelling platform: base, leg (full and reduced), arm, ground, directives."""
