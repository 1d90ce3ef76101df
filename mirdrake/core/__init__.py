"""Foundations of all stages: errors, files, paths, YAML with line numbers, named signals, user code, compiled code."""
