"""Models of the terrain simulator: its rail with sliders and links, and two plates."""
