"""Nonlinear shell analysis of thin elastic sheets.

Flat triangles with large displacements and small strains. Pure numerics without process knowledge.

``mesh`` generates triangles from the contours of walls, ``element`` computes their stiffness, ``corotation``
the forces and tangent of displaced and rotated triangles, and ``newton`` the states under loads. All
quantities are in SI units: m, N, Pa, rad.
"""
