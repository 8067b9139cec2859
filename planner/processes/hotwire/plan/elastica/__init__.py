"""The planar elastica: equations, clamped shapes with weight, their fit and their stability."""
