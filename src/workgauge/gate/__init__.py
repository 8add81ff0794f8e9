"""Last veto on the outgoing command bytes: starts closed, trusts nothing above it, small enough to port to C."""
