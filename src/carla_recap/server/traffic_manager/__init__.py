"""The traffic managers that clients run: which there are, their cycles, and their pause while an episode changes."""
