"""`python -m carla_recap`: the command line."""

from carla_recap.cli import main

main()
