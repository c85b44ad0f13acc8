"""From OpenDRIVE to the parts of a town, in a process of its own: CARLA's parser ends the process on some files."""
