"""Paths over sampled freedoms: reach, ladder, collisions, roadmap."""
