"""Simulation-based calibration of the identification: randomly drawn vehicles, drives, sensors and faults."""
