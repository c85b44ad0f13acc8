"""ScenarioRunner's metrics without a server."""
