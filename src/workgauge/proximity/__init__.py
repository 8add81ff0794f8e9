"""Signed clearances between the machine's link solids and limits, and between its own links."""
