"""Where the second tool is while the first one forms."""
