"""A town without a simulator: roads, signals, traffic and collisions in a plane, to record from and to replay into."""
