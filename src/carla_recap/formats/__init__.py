"""The file formats of recordings, each a reader and a writer of frames."""
