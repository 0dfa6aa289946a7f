"""The levelling platform: four parallelogram legs that level a mobile base.

Source of the equations: D. Feliu-Talegon, A. San-Millan, V. Feliu-Batlle, "A New Kinematic
Model and Control Strategy for a Mobile Platform for Transporting Lightweight Manipulators",
Applied Sciences 8 (2018) 2612. "Eq. (n)" in this package refers to that paper.
"""
