#!/usr/bin/env bash
# Simulate a crash, query it, convert and export it. Run it with `make demo`.
set -euo pipefail
cd "$(dirname "$0")/.."

say() {
    printf '\n# %s\n' "$*"
}

run() {
    printf '$ %s\n' "$*"
    "$@"
}

out=build/demo
mcap=$out/crash.mcap
mkdir -p "$out"
rm -rf "$out"/{crash,crossing,avoided,foxglove,compared}.* "$out/page"
export SOURCE_DATE_EPOCH=1767261600 # the date that the recordings get

simulates=true
python -c 'import carla' 2>/dev/null || simulates=false # not published for every system and Python
if $simulates; then
    say 'Simulate a minute: the hero hits a walker, and then a van that blocks its lane. The same seed gives the same bytes.'
    run carla-recap record "$mcap" --crash --vehicles 12 --walkers 8 --seed 7 --additional-data
else
    say "Simulating needs CARLA's library (Python up to 3.12, Linux or Windows), which is missing: take a sample instead."
    run cp samples/crash.mcap "$mcap"
fi

say 'List the collisions.'
run carla-recap collisions "$mcap"

say 'List the actors that stood still for 30 s or more: both cars of the crash, and the spectator, which CARLA counts, too.'
run carla-recap blocked "$mcap"

if $simulates; then
    say 'Replay the first 11 s, then let the autopilot drive, one second before the crash: no vehicle collides.'
    run carla-recap replay "$mcap" "$out/avoided.mcap" --duration 11 --then 15
    run carla-recap collisions "$out/avoided.mcap"
fi

say 'Convert a CARLA log to MCAP and back: the same bytes.'
run carla-recap convert samples/crossing.log "$out/crossing.mcap"
run carla-recap convert "$out/crossing.mcap" "$out/crossing.log"
run cmp samples/crossing.log "$out/crossing.log"

say 'Make the incident page, and export the recording for Rerun and for Foxglove.'
run carla-recap report "$mcap" "$out/page"
if $simulates; then
    run carla-recap report "$mcap" "$out/avoided.mcap" "$out/compared.html"
fi
run carla-recap export "$mcap" "$out/crash.rrd"
run carla-recap export "$mcap" "$out/foxglove.mcap"

hint() {
    printf '%-52s # %s\n' "$1" "$2"
}

say "All files are in $out. To open them, with .venv/bin on the PATH:"
hint "$out/page/index.html" 'the incident page: open it in any browser'
if $simulates; then
    hint "$out/compared.html" 'the crash, and how it is avoided, side by side'
fi
hint "rerun $out/crash.rrd" "Rerun's viewer; or: carla-recap view $mcap --web"
hint "$out/foxglove.mcap" 'open it in Foxglove, with the layout named above'
hint "carla-recap snapshot $mcap crash.png --at 12" 'takes a picture, without a display'
say 'More queries:'
hint "carla-recap collisions $mcap --types hv" 'collisions of the hero with vehicles'
hint "carla-recap blocked $mcap --min-time 5" 'shorter stops, too'
hint "carla-recap info $mcap --all" 'every record of every frame'
hint 'carla-recap convert YOUR.log YOUR.mcap' 'a recording of yours'
