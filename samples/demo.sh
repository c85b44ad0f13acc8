#!/usr/bin/env bash
# What carla-recap is for, on the recording next to this script. Run it with `make demo`.
set -euo pipefail
cd "$(dirname "$0")/.."

run() {
    printf '\n$ %s\n' "$*"
    "$@"
}

log=samples/crossing.log
out=build/demo
mkdir -p "$out"
rm -f "$out"/crossing.*

run carla-recap convert "$log" "$out/crossing.mcap"
run carla-recap convert "$out/crossing.mcap" "$out/crossing.log"
run cmp "$log" "$out/crossing.log"

run carla-recap info "$out/crossing.mcap"
run carla-recap actors "$out/crossing.mcap"
run carla-recap collisions "$out/crossing.mcap"
run carla-recap blocked "$out/crossing.mcap"

printf '\nThe recording as MCAP, and as a CARLA log again, byte for byte the same:\n'
ls -l "$out/crossing.mcap" "$out/crossing.log"
