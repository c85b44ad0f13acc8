"""Queries over a recording: what it contains, collisions, stationary actors, the actors, and incidents, as typed rows."""
