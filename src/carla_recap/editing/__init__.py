"""Recordings made from recordings, or from nothing: convert, clip, recover, author."""
