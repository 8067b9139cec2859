"""Writes panel_1.yaml to panel_3.yaml, three neighbouring panels of one column capital, and problem.yaml, the
middle one.

The capital stands over a 370 x 370 mm column: base arc of radius 300 mm, Bezier profiles 680 mm high that
change along the arc, panels 20 mm thick from blocks 100 mm thick. Run it again after changing a number here.
"""

from __future__ import annotations

from pathlib import Path

TEMPLATE = """\
# One of three neighbouring panels of a column capital: the faces, cut by a bent wire that two arms hold.
# Written by make_panels.py, which says where the numbers come from.
tandem: 1
name: {name}
cell: ../cells/two_irb140_facing.yaml
settings: {{clearance_mm: 10}}
stock:
  size_mm: [170, 700, 100]
  place: auto
  support:               # a stand; what is below the floor does not matter
    - {{kind: box, size_mm: [100, 540, 900], pose: {{xyz_mm: [0, 0, -450]}}}}
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
  - name: faces
    process: elastic_wire
    arms: [left, right]
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


def main() -> None:
    """Write the four files beside this one."""
    folder = Path(__file__).parent
    for i in range(3):
        text = TEMPLATE.format(name=f"capital_panel_{i + 1}", u0=i / 3, u1=(i + 1) / 3)
        (folder / f"panel_{i + 1}.yaml").write_text(text)
        if i == 1:
            (folder / "problem.yaml").write_text(text.replace("capital_panel_2", "column_capital"))


if __name__ == "__main__":
    main()
