"""Programs in any robot language: steps, text, what operators read, meetings of two controllers."""
