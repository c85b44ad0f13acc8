"""The data model of a recording: record types and their layouts, batches and frames, and the actors over time."""
