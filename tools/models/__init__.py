"""Makes the models of actors, which are files in `viewer/models/`."""
