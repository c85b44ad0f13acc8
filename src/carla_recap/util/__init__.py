"""Helpers without knowledge of recordings: child processes and signals."""
