"""Show the collisions of a recording between two types of actors.

The types are h (hero), v (vehicle), w (walker), t (traffic light), o (other) and a (any): `-t hw` is for heroes that hit
walkers.
"""

from common import connect, recording_options


def main():
    """Print the answer of the server."""
    parser = recording_options(__doc__)
    parser.add_argument("-t", "--types", default="aa", metavar="T", help="the two types, such as vv; h, v, w, t, o or a")
    arguments = parser.parse_args()
    if len(arguments.types) != 2:
        parser.error(f"-t {arguments.types}: expected two letters")
    print(connect(arguments).show_recorder_collisions(arguments.recorder_filename, *arguments.types))


if __name__ == "__main__":
    main()
