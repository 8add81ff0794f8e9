"""A path of the tool: its points and orientations by distance, the joints along it, their times."""
