"""Recordings as MCAP files with the protobuf schemas of `proto/carla_recap/v1`."""
