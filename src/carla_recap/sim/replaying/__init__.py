"""Replaying recordings in a world."""
