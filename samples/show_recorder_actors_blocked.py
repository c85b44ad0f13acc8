"""Show the actors of a recording that stood still for long."""

from common import connect, recording_options


def main():
    """Ask the server, and print its answer."""
    parser = recording_options(__doc__)
    parser.add_argument("-t", "--time", default=30.0, type=float, metavar="T", help="for at least so many seconds")
    parser.add_argument("-d", "--distance", default=100.0, type=float, metavar="D", help="within so many centimetres")
    arguments = parser.parse_args()
    limits = (arguments.time, arguments.distance)
    print(connect(arguments).show_recorder_actors_blocked(arguments.recorder_filename, *limits))


if __name__ == "__main__":
    main()
