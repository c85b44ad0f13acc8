"""What can be spawned, and the actors that are."""
