"""The browser page: snapshots out, intents in."""
