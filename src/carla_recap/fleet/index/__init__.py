"""The index of many recordings: a DuckDB file, which is written incrementally and queried with SQL."""
