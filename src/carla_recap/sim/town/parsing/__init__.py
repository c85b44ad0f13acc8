"""Parsing of OpenDRIVE into a town, in a child process, since CARLA's parser ends the process on some files."""
