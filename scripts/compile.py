"""Compile what tests need, once: test processes that begin side by side would each compile it for themselves."""

from workgauge import Session

session = Session(guard="barrier", joints="hydraulic")
session.warm_up()
session.step(session.intent())
