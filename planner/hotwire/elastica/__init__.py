"""The planar elastica: equations, shapes with and without weight, their fit and their stability."""
