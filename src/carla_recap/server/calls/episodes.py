"""Calls that begin a new episode: another map, the same one again, or one that a client sends."""
