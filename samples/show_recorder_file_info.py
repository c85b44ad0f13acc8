"""Show what is in a recording: who was spawned and destroyed, and who collided; or everything, frame by frame."""

from common import connect, recording_options


def main():
    """Ask the server, and print its answer."""
    parser = recording_options(__doc__)
    parser.add_argument("-a", "--show-all", action="store_true", help="show every frame, with all that is recorded of it")
    arguments = parser.parse_args()
    print(connect(arguments).show_recorder_file_info(arguments.recorder_filename, arguments.show_all))


if __name__ == "__main__":
    main()
