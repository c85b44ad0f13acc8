"""Functions for campaigns of tests."""

import os
import subprocess
import sys
import time
from tempfile import TemporaryDirectory

from carla_recap.sim.traffic import populate


def drive(world, vehicles=2, seconds=2.0):
    populate(world, vehicles, 0, hero=True)
    world.run(seconds)


def wait_here(world, vehicles=1):
    populate(world, vehicles, 0, hero=True)


def misbehave(world, how):
    if how == "do not tick":
        return
    if how == "record elsewhere":
        with TemporaryDirectory() as folder:
            world.start_recorder(f"{folder}/other.mcap")
            world.run(0.1)
            world.stop_recorder()
        return
    world.run(0.1)
    print("about to", how, flush=True)
    match how:
        case "raise":
            raise KeyError("three")
        case "exit":
            sys.exit(3)
        case "end":
            os._exit(5)
        case "fork":
            os.fork()
        case "hang":
            time.sleep(1000)
        case "leave a process":
            subprocess.Popen(["sleep", "1000"])
        case "stop":
            world.stop_recorder()
        case "print":
            print("x" * 1_000_000)
