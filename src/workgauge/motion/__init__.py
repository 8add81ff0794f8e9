"""What is wanted: levers, goals and paths to desired joint velocity, tick by tick."""
