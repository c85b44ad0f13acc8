#!/usr/bin/env bash
# Evaluate an agent by CARLA's Leaderboard on carla-recap's server, and print the result; see docs/leaderboard.md.
#
#     LEADERBOARD_ROOT=…/leaderboard SCENARIO_RUNNER_ROOT=…/scenario_runner CARLA_ROOT=…/carla samples/leaderboard.sh [ROUTES.xml]
#
# As for the Leaderboard's own script: TEAM_AGENT and TEAM_CONFIG (the agent and its configuration, by default the sample agent
# without one), CHALLENGE_TRACK_CODENAME (MAP), REPETITIONS (1), ROUTES_SUBSET, CHECKPOINT_ENDPOINT, RECORD_PATH, PORT (2000)
# and TM_PORT (8000). Results and recordings go to RESULTS (leaderboard-results) unless these say otherwise. CARLA_RECAP_MAPS
# names the folder of the towns.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
: "${LEADERBOARD_ROOT:?is not set: the folder of a checkout of the Leaderboard}"
: "${SCENARIO_RUNNER_ROOT:?is not set: the folder of a checkout of ScenarioRunner}"
: "${CARLA_ROOT:?is not set: the folder with PythonAPI/carla/agents, of a checkout or a release of CARLA}"
evaluator=$LEADERBOARD_ROOT/leaderboard/leaderboard_evaluator.py
for needed in "$evaluator" "$SCENARIO_RUNNER_ROOT/srunner" "$CARLA_ROOT/PythonAPI/carla/agents"; do
    [ -e "$needed" ] || { echo "$0: there is no $needed" >&2; exit 2; }
done

export LEADERBOARD_ROOT=$(realpath "$LEADERBOARD_ROOT") SCENARIO_RUNNER_ROOT=$(realpath "$SCENARIO_RUNNER_ROOT")
routes=$(realpath "${1:-${ROUTES:-$here/leaderboard/brickfield.xml}}")
agent=$(realpath "${TEAM_AGENT:-$here/leaderboard/route_agent.py}")
python=${PYTHON:-python}
port=${PORT:-2000}
mkdir -p "${RESULTS:=leaderboard-results}"
RESULTS=$(realpath "$RESULTS")
checkpoint=$(realpath -m "${CHECKPOINT_ENDPOINT:-$RESULTS/results.json}")
records=$(realpath -m "${RECORD_PATH:-$RESULTS}")
mkdir -p "$records"
export CHALLENGE_TRACK_CODENAME=${CHALLENGE_TRACK_CODENAME:-MAP}

answers() { (exec 3<> "/dev/tcp/127.0.0.1/$port") 2> /dev/null; }
if answers; then
    echo "$0: port $port is taken; set PORT to another one" >&2
    exit 2
fi
"$python" -m carla_recap serve --port "$port" --recordings "$records" > "$RESULTS/server.txt" 2>&1 &
server=$!
trap 'kill "$server" 2> /dev/null || true; wait "$server" || true' EXIT
until answers; do
    kill -0 "$server" 2> /dev/null || { cat "$RESULTS/server.txt" >&2; exit 2; }
    sleep 0.2
done

modules=$LEADERBOARD_ROOT:$SCENARIO_RUNNER_ROOT:$(realpath "$CARLA_ROOT")/PythonAPI/carla
code=0
PYTHONPATH=$modules${PYTHONPATH:+:$PYTHONPATH} SDL_VIDEODRIVER=dummy "$python" -u "$LEADERBOARD_ROOT/leaderboard/leaderboard_evaluator.py" \
    --port="$port" --traffic-manager-port="${TM_PORT:-8000}" --timeout="${TIMEOUT:-120}" \
    --routes="$routes" --routes-subset="${ROUTES_SUBSET:-}" --repetitions="${REPETITIONS:-1}" \
    --track="$CHALLENGE_TRACK_CODENAME" --agent="$agent" --agent-config="${TEAM_CONFIG:-}" \
    --checkpoint="$checkpoint" --debug-checkpoint="$RESULTS/live.txt" --record="$records" \
    > "$RESULTS/evaluator.txt" 2>&1 || code=$?

"$python" "$here/leaderboard/print_results.py" "$checkpoint" || { tail -n 20 "$RESULTS/evaluator.txt" >&2; exit 2; }
echo "logs: $RESULTS; recordings: $records"
exit "$code"
