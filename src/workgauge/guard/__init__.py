"""Desired joint velocity and clearances to allowed joint velocity and reasons; one file per guard."""
