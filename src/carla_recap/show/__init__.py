"""Recordings in viewers: Rerun, Foxglove, videos and pictures, and the incident page; each with the extra that it needs."""
