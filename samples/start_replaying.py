"""Replay a recording: all of it or a part, at any speed, with the camera behind one of its actors."""

from common import connect, recording_options


def main():
    """Begin a replay, which continues after this script has ended."""
    parser = recording_options(__doc__)
    parser.add_argument(
        "-s", "--start", default=0.0, type=float, metavar="S", help="starting time in s; negative: from the end"
    )
    parser.add_argument("-d", "--duration", default=0.0, type=float, metavar="D", help="duration in s; 0: to the end")
    parser.add_argument(
        "-c", "--camera", default=0, type=int, metavar="C", help="id of the recorded actor to follow; 0: none"
    )
    parser.add_argument("-x", "--time-factor", "--factor", default=1.0, type=float, metavar="X", help="the time factor")
    parser.add_argument("-i", "--ignore-hero", action="store_true", help="leave the hero out")
    parser.add_argument("--move-spectator", action="store_true", help="move the spectator as in the recording")
    parser.add_argument("--spawn-sensors", action="store_true", help="spawn the sensors of the recording")
    arguments = parser.parse_args()

    client = connect(arguments)
    client.set_replayer_time_factor(arguments.time_factor)
    client.set_replayer_ignore_hero(arguments.ignore_hero)
    client.set_replayer_ignore_spectator(not arguments.move_spectator)
    part = (arguments.start, arguments.duration)
    print(client.replay_file(arguments.recorder_filename, *part, arguments.camera, arguments.spawn_sensors))


if __name__ == "__main__":
    main()
