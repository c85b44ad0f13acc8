"""Speed and sizes, as docs/performance.md states them: `python -m benchmarks`."""
