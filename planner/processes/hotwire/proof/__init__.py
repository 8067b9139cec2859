"""The wire along the motion, a discrete elastic rod, and the surface that it leaves."""
