#!/usr/bin/env bash
# What carla-recap is for, on the recording next to this script. Run it with `make demo`.
set -euo pipefail
cd "$(dirname "$0")/.."

say() {
    printf '\n# %s\n' "$*"
}

run() {
    printf '$ %s\n' "$*"
    "$@"
}

log=samples/crossing.log
out=build/demo
mcap=$out/crossing.mcap
mkdir -p "$out"
rm -f "$out"/crossing.*

say 'From a CARLA log to MCAP and back: not a byte is lost.'
run carla-recap convert "$log" "$mcap"
run carla-recap convert "$mcap" "$out/crossing.log"
run cmp "$log" "$out/crossing.log"

say 'What happened?'
run carla-recap info "$mcap" --text

say 'Who was there?'
run carla-recap actors "$mcap"

say 'Who collided with whom? A cyclist with a pedestrian, and the hero with the car that waits at the red light.'
run carla-recap collisions "$mcap"

say 'Who stood still for 30 s or more? A van that broke down; and props, which CARLA counts too.'
run carla-recap blocked "$mcap"

say 'What went wrong, for a browser: a page of plain files. And for the Rerun viewer, behind the hero.'
rm -rf "$out/page"
run carla-recap report "$mcap" "$out/page"
run carla-recap export "$mcap" "$out/crossing.rrd"

cat <<END

# The files are in $out: crossing.mcap, crossing.log, crossing.rrd, page/index.html. Try next, with .venv/bin on the PATH:
rerun $out/crossing.rrd                   # the viewer; or: carla-recap view $mcap --web
carla-recap collisions $mcap --types hv   # only the hero's, with vehicles
carla-recap blocked $mcap --min-time 5    # who waited, too
carla-recap info $mcap --all              # every record of every frame
carla-recap convert YOUR.log YOUR.mcap                      # a recording of yours
END
