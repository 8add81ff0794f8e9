"""Seeded random drives of a machine among limits, with simulated hydraulics: what judges a guard."""
