"""Simulated sensors: receivers that write real NMEA and UBX bytes, link sensors that write frames of our own."""
