"""Blind set for tuning: vehicles and delays drawn by seed, tuned with default studies, driven on other courses."""
