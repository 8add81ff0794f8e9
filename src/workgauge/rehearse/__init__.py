"""The loop and a simulated machine without a clock: scenarios, sessions, geometric truth, runs."""
