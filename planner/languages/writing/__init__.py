"""Shared parts of the writers of all languages: `Writer`, steps, layout, handshake and `write`."""
