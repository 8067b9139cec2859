"""Writes problem.yaml beside this file: one element of a ruled wall, cut in two passes.

It is 40 mm thick between two ruled faces; its outline has a round tongue on one side and, on the other, the
groove that a neighbour's tongue fills.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from shapely.geometry import Polygon

WIDE, HIGH = 210.0, 520.0
NECK, RADIUS, ROUND = 12.0, 34.0, 4.0

TEXT = """\
# One element of a ruled wall: the bow cuts the ruled front and back of the block that lies on a stand; then
# the block is put upright and the outline is cut, with a tongue and a groove that hold neighbours together.
# Written by make_wall.py.
tandem: 1
name: ruled_wall
cell: ../cells/irb140_bow.yaml
stock:
  size_mm: [290, 600, 100]
  foam: eps_a120
  place: auto
  support:
    - {{kind: box, size_mm: [120, 360, 600], pose: {{xyz_mm: [0, 0, -300]}}}}
part:
  ruled:
    - name: front
      start:
        bspline_mm: [[-145, -300, 62], [-145, -150, 78], [-145, 0, 84], [-145, 150, 74], [-145, 300, 58]]
      end:
        bspline_mm: [[145, -300, 72], [145, -150, 66], [145, 0, 70], [145, 150, 80], [145, 300, 76]]
      flip: true
    - name: back
      start:
        bspline_mm: [[-145, -300, 22], [-145, -150, 38], [-145, 0, 44], [-145, 150, 34], [-145, 300, 18]]
      end:
        bspline_mm: [[145, -300, 32], [145, -150, 26], [145, 0, 30], [145, 150, 40], [145, 300, 36]]
    - name: outline
      closed: true
      start: {{polyline_mm: {low}}}
      end: {{polyline_mm: {high}}}
  in_stock: {{}}
operations:
  - name: faces
    process: straight_wire
    arms: [robot]
    power_w: 46
    feed_mm_s: 6
    feed_min_mm_s: 4
    shape_tol_mm: 0.4
    cuts:
      - {{surface: front}}
      - {{surface: back}}
  - name: outline
    process: straight_wire
    arms: [robot]
    setup:
      place: auto
      roll_pitch_deg: [90, 0]          # upright on a post
      support:
        - {{kind: box, size_mm: [90, 700, 80], pose: {{xyz_mm: [0, -650, 50]}}}}
    power_w: 46
    feed_mm_s: 6
    feed_min_mm_s: 4
    shape_tol_mm: 0.4
    cuts:
      - {{surface: outline, last: [0, 1, 0]}}   # the top last, so that the element stands until then
"""


def outline() -> np.ndarray:
    """Points (N, 2) [mm]: a rectangle with a tongue on the right and the same as a groove on the left."""
    turn = np.arcsin(NECK / RADIUS)
    arc = np.linspace(-np.pi + turn + 0.6, np.pi - turn - 0.6, 40)
    knob = np.stack([np.cos(arc), np.sin(arc)], axis=1) * RADIUS + [RADIUS * 0.55, 0.0]
    half = 0.5 * np.array([WIDE, HIGH])
    left, right = np.array([-half[0], 0.0]), np.array([half[0], 0.0])
    groove = left + knob[::-1]
    tongue = right + knob
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
    points = np.concatenate([tongue, corners[:2], groove, corners[2:]])
    sharp = Polygon(points - [0.5 * RADIUS, 0.0])
    # a wire leaves inner corners round: they are drawn so
    round_ = sharp.buffer(ROUND, 24).buffer(-2.0 * ROUND, 24).buffer(ROUND, 24)
    return np.array(round_.simplify(0.02).exterior.coords)[:-1]


def main() -> None:
    """Write the problem."""
    flat = outline()
    rows = [[[round(float(x), 3), round(float(y), 3), z] for x, y in flat] for z in (0, 100)]
    Path(__file__).with_name("problem.yaml").write_text(TEXT.format(low=rows[0], high=rows[1]))


if __name__ == "__main__":
    main()
