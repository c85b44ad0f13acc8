"""Rules on one recording: files of rules, their conditions, and whether a recording meets them."""
