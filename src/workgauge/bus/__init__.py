"""Adapters to the world: serial ports; the real clock."""
