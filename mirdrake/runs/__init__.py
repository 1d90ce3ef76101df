"""Simulate a diagram: the run loop, what it logs and records, and its summary."""
