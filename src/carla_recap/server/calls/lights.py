"""Calls about traffic lights."""
