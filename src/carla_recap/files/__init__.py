"""Recordings as files of other formats: Parquet, CSV, OSI, OpenSCENARIO; each with the extra that it needs."""
