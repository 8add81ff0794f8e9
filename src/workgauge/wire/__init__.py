"""Bytes to values and back, one table both ways. No sockets, no clocks."""
