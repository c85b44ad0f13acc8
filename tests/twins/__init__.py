"""Slow and obvious twins of what computes in a clever way, for tests that compare both."""
