"""Calls about walkers."""
