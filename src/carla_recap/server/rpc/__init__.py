"""Remote procedure calls as CARLA's client makes them: connections, messages, the codec, the structs and the calls."""
