#!/bin/sh
# Starts `carla-recap serve` with the arguments of CARLA's own CarlaUE4.sh, from a clone; see docs/serving.md.
# The Python is that of an active virtual environment, else that of .venv, else the system's.
here=$(CDPATH= cd -- "$(dirname -- "$(readlink -f -- "$0")")" && pwd) || exit
if [ -n "$VIRTUAL_ENV" ]; then
    python=$VIRTUAL_ENV/bin/python
elif [ -x "$here/.venv/bin/python" ]; then
    python=$here/.venv/bin/python
else
    python=python3
fi
PYTHONPATH=$here/src${PYTHONPATH:+:$PYTHONPATH}
export PYTHONPATH
exec "$python" -P -c 'from carla_recap.cli.server import launch; launch()' "$@"
