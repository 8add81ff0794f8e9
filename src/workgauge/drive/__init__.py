"""Joint velocity to integer valve command and back."""
