"""`python -m carla_recap.cli`."""

from carla_recap.cli import main

main()
