"""What the writers of all languages share: steps, layout, handshake, and the entry point `write`."""
