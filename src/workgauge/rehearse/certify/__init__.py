"""The stop certificate: random drives at a machine's own stopping model, its tolerances and injected delays."""
