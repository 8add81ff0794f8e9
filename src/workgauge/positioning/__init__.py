"""Measurements become the machine's pose, its posture, their uncertainty and how far they may be trusted."""
