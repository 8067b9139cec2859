"""The elastic sheet: thin shells of flat triangles under large displacements. Pure numerics: knows no
process.

``mesh`` makes triangles of rings of contours, ``element`` their stiffness, ``corotation`` forces and tangent
of displaced and turned triangles, ``newton`` the states under loads. All is in SI units: m, N, Pa, rad."""
