"""The protobuf messages of `proto/carla_recap/v1`, generated."""
