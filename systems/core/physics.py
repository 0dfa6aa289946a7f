"""Constants of physics."""

# Acceleration of gravity in all plants: Drake's own [m/s^2].
GRAVITY = 9.81
# Standard gravity, of which data sheets count accelerations in g [m/s^2].
STANDARD_GRAVITY = 9.80665
