"""Batches of commands, which clients send at once."""
