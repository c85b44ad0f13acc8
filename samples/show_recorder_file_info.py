"""Show the events of a recording, such as spawns and collisions, or all records of each frame."""

from common import connect, recording_options


def main():
    """Print the answer of the server."""
    parser = recording_options(__doc__)
    parser.add_argument("-a", "--show-all", action="store_true", help="show all records of each frame")
    arguments = parser.parse_args()
    print(connect(arguments).show_recorder_file_info(arguments.recorder_filename, arguments.show_all))


if __name__ == "__main__":
    main()
