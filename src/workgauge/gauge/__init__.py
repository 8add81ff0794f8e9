"""Rule books, and how a site model becomes limits that contain what they protect. No file format of sites."""
