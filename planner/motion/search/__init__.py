"""Path search over sampled freedoms: reach, layered graph, collisions, roadmap."""
