"""A bucket's edge drawn along a surface: poses, what the machine makes of them, passes and strokes."""
