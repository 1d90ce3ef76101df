"""Errors, paths, YAML with line numbers, named signals, user code, compiled functions: what every stage uses."""
