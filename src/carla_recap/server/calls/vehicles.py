"""Calls about vehicles."""
