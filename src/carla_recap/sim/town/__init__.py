"""The town: roads, lanes, signals and walkways, out of an OpenDRIVE file."""
