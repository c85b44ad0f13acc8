"""Recordings written from other recordings or from records: convert, clip, recover, author."""
