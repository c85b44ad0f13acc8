"""Conditions: what a rule demands of a recording, and how a recording is found to meet it or not."""
