"""The sensor ``lens``: film, glass as numbers on the device, the sequence of surfaces, ghosts."""
