"""Runs turned into pages and plots for people."""
