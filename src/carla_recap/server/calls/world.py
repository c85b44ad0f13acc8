"""Calls about the world around the actors, and those that are accepted although there is nothing to be done."""
