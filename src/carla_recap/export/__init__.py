"""Exports: a recording as Rerun, Foxglove, a picture or a page shows it; each behind the extra that it needs."""
