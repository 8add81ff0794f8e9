"""A machine that runs in real time: who drives it, what it is asked, what it tells."""
