"""Print the results of CARLA's Leaderboard: a line for each route, its infractions, and the means."""

import json
import sys
from pathlib import Path


def main():
    """Read the checkpoint that the evaluator has written."""
    if len(sys.argv) != 2:
        sys.exit("usage: print_results.py RESULTS.json")
    try:
        records = json.loads(Path(sys.argv[1]).read_text())["_checkpoint"]["records"]
    except (OSError, ValueError, KeyError):
        sys.exit(f"{sys.argv[1]} has no results of the Leaderboard")
    if not records:
        sys.exit(f"{sys.argv[1]} has no results: no route has ended")
    print(f"{'route':24} {'completion':>10} {'penalty':>8} {'score':>7} {'speed':>6}  status")
    for record in records:
        scores, meta = record["scores"], record["meta"]
        speed = meta["duration_game"] / max(meta["duration_system"], 0.001)
        print(
            f"{record['route_id']:24} {scores['score_route']:8.2f} % {scores['score_penalty']:8.3f} "
            f"{scores['score_composed']:7.2f} {speed:4.1f} x  {record['status']}"
        )
        for messages in record["infractions"].values():
            for message in messages:
                print(f"    {message}")
    names = ("score_route", "score_penalty", "score_composed")
    route, penalty, score = (sum(record["scores"][name] for record in records) / len(records) for name in names)
    print(f"{'mean':24} {route:8.2f} % {penalty:8.3f} {score:7.2f}")


if __name__ == "__main__":
    main()
