#!/usr/bin/env bash
# Simulates the recordings next to this script, or in the given folder; they are the same on every machine.
set -euo pipefail
folder=${1:-$(dirname "$0")}
export SOURCE_DATE_EPOCH=1767261600
# Disable instructions that only some processors have, since with these numpy rounds sines differently.
NPY_DISABLE_CPU_FEATURES=$(python -c 'from numpy._core._multiarray_umath import __cpu_dispatch__ as names; print(*names)')
export NPY_DISABLE_CPU_FEATURES

temporary=$(mktemp -d)
trap 'rm -rf "$temporary"' EXIT

record() {
    carla-recap record "$temporary/$1" --additional-data "${@:2}"
    carla-recap convert "$temporary/$1" "$folder/$1" --force # events at the end, which are read at once
}

record crash.mcap --crash --vehicles 3 --walkers 3 --duration 60 --seed 1
record blocked.mcap --blocked --vehicles 2 --walkers 3 --duration 60 --seed 5
record junction.mcap --junction --hero --vehicles 16 --walkers 8 --duration 30 --seed 33

# the crash, with the autopilot in all cars from 11 s on
carla-recap replay "$folder/crash.mcap" "$temporary/avoided.mcap" --duration 11 --then 15 --additional-data
carla-recap convert "$temporary/avoided.mcap" "$folder/avoided.mcap" --force
