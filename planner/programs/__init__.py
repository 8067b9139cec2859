"""Programs in any robot language: steps, text, operator texts, and handshakes of two controllers."""
