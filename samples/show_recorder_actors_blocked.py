"""Show the actors of a recording that stood still for long."""

from common import connect, recording_options


def main():
    """Print the answer of the server."""
    parser = recording_options(__doc__)
    parser.add_argument("-t", "--time", default=30.0, type=float, metavar="T", help="the shortest stop, in s")
    parser.add_argument(
        "-d", "--distance", default=100.0, type=float, metavar="D", help="the distance that counts as moving, in cm"
    )
    arguments = parser.parse_args()
    limits = (arguments.time, arguments.distance)
    print(connect(arguments).show_recorder_actors_blocked(arguments.recorder_filename, *limits))


if __name__ == "__main__":
    main()
