"""Built-in robots and materials."""
