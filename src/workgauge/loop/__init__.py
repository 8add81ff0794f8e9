"""One tick from measurements and intent to valve command bytes: pure, time is an argument."""
