"""Curves, surfaces and meshes. Nothing here depends on robots or processes."""
