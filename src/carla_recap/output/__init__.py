"""Answers of queries as CARLA's text, JSON and tables."""
