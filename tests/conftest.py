"""Property tests draw anew on every machine but the one that decides what lands: there, the same every time."""

import os

from hypothesis import settings

settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")
