"""Devices: bytes on a serial line to values, and emulators that speak the same bytes from the other side."""
