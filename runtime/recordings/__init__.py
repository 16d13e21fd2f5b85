"""Recordings of the bus: written, described, mended and played."""
