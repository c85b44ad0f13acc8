"""What the server sends by itself: streams, their subscribers, and the snapshots of the world."""
