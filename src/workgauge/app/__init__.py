"""The command line: wiring and formatting, no logic of its own."""
