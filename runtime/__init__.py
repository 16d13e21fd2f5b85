"""Processes, messages, recordings and commands around the drivers and the processing."""
