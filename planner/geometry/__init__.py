"""Curves, surfaces and meshes; knows no robot and no process."""
