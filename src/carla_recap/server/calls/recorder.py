"""Calls about recordings: recording, replaying and querying them."""
