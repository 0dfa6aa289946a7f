"""The levelling platform: slip of its feet, simulated and measured on a real machine."""
