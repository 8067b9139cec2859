"""Writes panel_1.yaml to panel_3.yaml, three neighbouring panels of one column capital; problem.yaml, the
middle one; and faces.yaml, which has a ready block and cuts the middle one's faces alone.

The capital stands over a 370 x 370 mm column: base arc of radius 300 mm, Bezier profiles 680 mm high that
change along the arc, panels 20 mm thick from blocks 100 mm thick. Run it again after changing a number here.
"""

from __future__ import annotations

from pathlib import Path

HEAD = """\
# One of three neighbouring panels of a column capital{what}
# Written by make_panels.py, which says where the numbers come from.
tandem: 1
name: {name}
cell: ../cells/two_irb140_facing.yaml
settings: {{clearance_mm: 10}}
stock:
  size_mm: [170, 700, 100]
  foam: eps_a120
"""

WHOLE = """. First a bow on one arm cuts the raw block to size, so
# that the block itself is the datum, and the panel's edges; then two arms bend a hot wire through it for its
# faces."""

FACES_ONLY = """: the faces, cut out of a ready block by a bent wire that two
# arms hold."""

STAND = """\
{indent}place: auto
{indent}support:               # a stand; what is below the floor does not matter
{indent}  - {{kind: box, size_mm: [100, 540, 900], pose: {{xyz_mm: [0, 0, -450]}}}}
"""

PART = """\
part:
  front:
    loft:
      rail: {{radius_mm: 300, start_deg: 0, end_deg: 63}}
      profiles:            # [out, up] from the base arc, in its normal planes
        - {{at: 0.0, bezier_mm: [[0, 0], [20, 230], [60, 450], [120, 680]]}}
        - {{at: 0.5, bezier_mm: [[0, 0], [5, 230], [40, 450], [110, 680]]}}
        - {{at: 1.0, bezier_mm: [[0, 0], [35, 230], [35, 450], [95, 680]]}}
      region: {{u: [{u0:.6f}, {u1:.6f}]}}
  back: {{offset_mm: 20}}
  in_stock: auto
operations:
"""

BLOCK = """\
  - name: block
    process: straight_wire
    arms: [left]
    setup:
      tools: {left: {kind: bow, tilt_deg: 45}}
      place: auto
      roll_pitch_deg: [90, 0]            # upright
      oversize_mm: [[10, 10], [30, 10], [10, 10]]
      support:             # a post below the raw block
        - {kind: box, size_mm: [80, 900, 80], pose: {xyz_mm: [0, -830, 50]}}
    power_w: 46
    feed_mm_s: 6
    feed_min_mm_s: 4
    step_mm: 8
    shape_tol_mm: 0.5
    spacers: true
    cuts:                  # the block's sides, the panel's edges, the block's front and back
      - {trim: [left, back, right, front]}
      - {surface: edges}
      - {trim: [top, bottom]}
"""

FACES = """\
  - name: faces
    process: elastic_wire
    arms: [left, right]
{setup}\
    wire: {{material: spring_steel, diameter_mm: 1.5, length_mm: 600, temperature_c: 300}}
    kerf_mm: 2.5
    feed_mm_s: 8
    feed_min_mm_s: 3
    shape_tol_mm: 0.5
    end_error_mm: 0.03    # the arms repeat to 0.03 mm
    faces: [front, back]
    runs: one
    sweep: y
"""

AGAIN = """\
    setup:
      tools: {left: {kind: wire_holder, mounting: across, side: start}}
"""


def problem(name: str, number: int, whole: bool) -> str:
    """The text of one problem; ``number`` of the panel from 0."""
    ends = {"u0": number / 3, "u1": (number + 1) / 3}
    head = HEAD.format(what=WHOLE if whole else FACES_ONLY, name=name)
    stand = STAND.format(indent=" " * (6 if whole else 2))
    setup = AGAIN + stand if whole else ""
    before = "" if whole else stand
    return head + before + PART.format(**ends) + (BLOCK if whole else "") + FACES.format(setup=setup)


def main() -> None:
    """Write the five files beside this one."""
    folder = Path(__file__).parent
    for i in range(3):
        (folder / f"panel_{i + 1}.yaml").write_text(problem(f"capital_panel_{i + 1}", i, True))
    (folder / "problem.yaml").write_text(problem("column_capital", 1, True))
    (folder / "faces.yaml").write_text(problem("capital_faces", 1, False))


if __name__ == "__main__":
    main()
