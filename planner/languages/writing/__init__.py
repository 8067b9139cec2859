"""What writers of all languages share: `Writer`, steps, layout, handshake, and the entry point `write`."""
