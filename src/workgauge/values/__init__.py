"""Frozen value types with frame, unit and time stamp; reasons, errors and ports. No input or output."""
