"""Simulated machines that speak the same bytes as real ones."""
