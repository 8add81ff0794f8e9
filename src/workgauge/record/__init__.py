"""The append-only log of everything that enters and leaves the tick, and replaying from it."""
