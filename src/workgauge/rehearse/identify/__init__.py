"""How a machine stops, found from a log of steps and stops."""
