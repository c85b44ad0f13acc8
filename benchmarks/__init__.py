"""Speed and sizes, as the README states them: `python -m benchmarks`."""
