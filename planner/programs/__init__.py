"""Programs as read: steps, handshake and signals, whatever their language."""
