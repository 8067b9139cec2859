"""Small jobs for all processes and modes, as problem files, for faults that are put into the planner.

Each function writes its files into a folder and returns the path of the problem file.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import rhino3dm
import trimesh
import yaml

from planner.catalogue.robots import data_dir, robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import Mesh, from_rpy, to_quaternion
from tests import gantry_job, small_forming, urdf_text
from tests.processes.forming.plan.shapes import cone
from tests.processes.milling.plan import small_mill
from tests.processes.trim.plan import small_trim
from tests.rhino_files import Model, curve, ruled_surface

CELLS = data_dir("problems") / "cells"
UPRIGHT = {"xyz_mm": [250, -1030, 900], "rpy_deg": [90, 0, -84.5]}
KUKA_HOME = [0, -110, 110, 0, 60, 0]
UR_HOME = [180, -60, 100, -130, -90, 0]
UR10E = {"urdf": "ur10e.urdf", "name": "ur10e", "family": "ur", "payload_kg": 12.5}
GAUGE: dict[str, Any] = {
    "kind": "plain",
    "tcp": {"xyz_mm": [20, 10, 160], "rpy_deg": [0, 20, 0]},
    "mass_kg": 0.9,
    "cog_mm": [0, 0, 60],
    "shapes": [{"kind": "cylinder", "radius_mm": 20, "length_mm": 90, "pose": {"xyz_mm": [0, 0, 50]}}],
}
ARMS: Final[tuple[dict[str, Any], ...]] = (
    {
        "name": "left",
        "robot": "irb140",
        "base": {"xyz_mm": [-850, 0, 0]},
        "tool": GAUGE,
        "home_deg": [0, -10, 10, 0, 60, 0],
    },
    {
        "name": "right",
        "robot": "irb140",
        "base": {"xyz_mm": [850, 0, 0], "rpy_deg": [0, 0, 180]},
        "tool": GAUGE,
        "home_deg": [0, -10, 10, 0, 60, 0],
    },
)
WIRE: dict[str, Any] = {
    "material": "spring_steel",
    "diameter_mm": 1.5,
    "length_mm": 520,
    "temperature_c": 300,
}


def _cell(name: str) -> dict[str, Any]:
    return dict(yaml.safe_load((CELLS / f"{name}.yaml").read_text()))


def _write(folder: Path, data: Mapping[str, Any]) -> Path:
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(dict(data)))
    return path


def _standing(arm: Mapping[str, Any]) -> np.ndarray:
    """Pose (4, 4) of the TCP of an arm at home in the world."""
    place, tcp = arm.get("base", {}), arm["tool"]["tcp"]
    base = from_rpy(
        np.array(place.get("xyz_mm", [0, 0, 0])) / 1e3, np.deg2rad(place.get("rpy_deg", [0, 0, 0]))
    )
    tool = from_rpy(np.array(tcp["xyz_mm"]) / 1e3, np.deg2rad(tcp.get("rpy_deg", [0, 0, 0])))
    model = urdf_text.UR10E if isinstance(arm["robot"], dict) else robot(arm["robot"])
    return np.asarray(
        base @ forward_kinematics(model, np.deg2rad(np.array(arm["home_deg"], dtype=float))) @ tool
    )


def posed(
    folder: Path,
    arms: int = 1,
    kuka: bool = False,
    handshake: bool = False,
    aside: float = 0.0,
    feed: float = 20.0,
    ur: bool = False,
) -> Path:
    """One or two arms pass poses of a table, near home, with rotation and a free spin.

    ``aside`` [m]: the poses are shifted to the right by this, behind a post. ``feed`` [mm/s].
    """
    used = copy.deepcopy(list(ARMS[:arms]))
    if kuka:
        used[0] |= {"robot": "kr10_r1100", "home_deg": KUKA_HOME}
    if ur:
        (folder / "ur10e.urdf").write_text(urdf_text.ur10e(), "utf-8")
        for arm in used:
            arm |= {"robot": UR10E, "home_deg": UR_HOME}
    names = [arm["name"] for arm in used]
    rows = []
    for k in range(7):
        row: dict[str, float] = {"feed_mm_s": feed}
        for arm in used:
            turn = from_rpy([0.0, 0.0, 0.0], np.deg2rad([3.0 * k, 2.0 * k, 0.0]))
            pose = _standing(arm) @ turn
            pose[:3, 3] += np.array([0.004 * k, -0.05 - aside + 0.015 * k, 0.002 * k * k])
            values = [*(1e3 * pose[:3, 3]), *to_quaternion(pose[:3, :3])]
            columns = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
            row |= {f"{arm['name']}.{c}": float(v) for c, v in zip(columns, values, strict=True)}
        rows.append(row)
    lines = [",".join(rows[0]), *(",".join(f"{v:.9f}" for v in row.values()) for row in rows)]
    (folder / "targets.csv").write_text("\n".join(lines) + "\n")
    controller: dict[str, Any] = {"tasks": [f"T_ROB{i + 1}" for i in range(arms)]}
    controller["units"] = [f"ROB_{i + 1}" for i in range(arms)]
    if handshake:
        controller = {"tasks": ["T_ROB1"] * 2, "units": ["ROB_1"] * 2, "sync": "handshake"}
    if ur:
        controller["io"] = {
            arm: dict(zip(("doPartner", "diPartner", "doRunning", "diPartnerRunning"), numbers, strict=True))
            for arm, numbers in (("left", (0, 0, 1, 1)), ("right", (2, 2, 3, 3)))
        }
    if kuka:
        controller = {"dialect": "krc4"}
    operation = {
        "name": "poses",
        "process": "targets",
        "arms": names,
        "file": "targets.csv",
        "frame": "world",
        "free": [{"name": f"spin_{n}", "arms": [n], "axis": "z", "turn_deg": [-30, 30]} for n in names],
    }
    cell: dict[str, Any] = {"name": "cell", "arms": used, "controller": controller}
    if aside:
        base, tcp = -0.85, _standing(used[0])[:3, 3]
        reach, turn = float(tcp[0]) - base, np.deg2rad(18.0)
        at = np.array([base + reach * np.cos(turn), -reach * np.sin(turn), float(tcp[2]) + 0.06])
        shape = {"kind": "box", "size_mm": [60, 40, 160], "pose": {"xyz_mm": (1e3 * at).tolist()}}
        cell["obstacles"] = [{"name": "post", "shapes": [shape]}]
    data = {
        "tandem": 1,
        "name": "poses",
        "cell": cell,
        "stock": {"size_mm": [100, 100, 100], "place": {"xyz_mm": [0, 500, 0]}},
        "operations": [operation],
    }
    return _write(folder, data)


def elastic(folder: Path, diameter: float = 1.5, length: float = 520.0, **fields: Any) -> Path:
    """A bent wire between two arms cuts the front of a small vault, whose sections change along it."""
    profile = [[-70.0, 0.0], [-25.0, 21.0], [25.0, 21.0], [70.0, 0.0]]
    sections = [
        {"at": at, "bezier_mm": [[x, -60.0 + 120.0 * at, z * (1.0 - 0.2 * at)] for x, z in profile]}
        for at in (0.0, 1.0)
    ]
    data = {
        "tandem": 1,
        "name": "vault",
        "accept": ["stock.hangs"],
        "cell": _cell("two_irb140_facing"),
        "settings": {"clearance_mm": 10},
        "stock": {"size_mm": [160, 130, 100], "foam": "eps_a120", "place": {"xyz_mm": [0, 0, 560]}},
        "part": {"front": {"loft": {"sections": sections, "flip": True}}, "in_stock": "auto"},
        "operations": [
            {
                "name": "faces",
                "process": "elastic_wire",
                "arms": ["left", "right"],
                "wire": {**WIRE, "diameter_mm": diameter, "length_mm": length},
                **({"kerf_mm": 2.4} | fields),
                "feed_mm_s": 8,
                "feed_min_mm_s": 3,
                "faces": ["front"],
                "sweep": "y",
                "step_mm": 6,
            }
        ],
    }
    return _write(folder, data)


def _straight(part: Mapping[str, Any], **fields: Any) -> dict[str, Any]:
    """A block of 200 x 120 x 100 mm before an arm with a bow."""
    operation = {
        "name": "cut",
        "process": "straight_wire",
        "arms": ["robot"],
        "power_w": 44,
        "feed_mm_s": 6,
        "feed_min_mm_s": 4,
        "shape_tol_mm": 0.3,
        "step_mm": 3,
        "cuts": "all",
        **fields,
    }
    return {
        "tandem": 1,
        "name": "straight",
        "cell": _cell("irb140_bow"),
        "stock": {
            "size_mm": [160, 200, 100],
            "foam": "eps_a120",
            "place": "auto",
            "support": [{"kind": "box", "size_mm": [80, 120, 500], "pose": {"xyz_mm": [0, 0, -250]}}],
        },
        "part": dict(part),
        "operations": [operation],
    }


WALL: Final = {
    "ruled": [
        {
            "name": "front",
            "start": {"bspline_mm": [[-80, -100, 62], [-80, -40, 74], [-80, 40, 70], [-80, 100, 58]]},
            "end": {"bspline_mm": [[80, -100, 70], [80, -40, 64], [80, 40, 72], [80, 100, 66]]},
            "flip": True,
        }
    ],
    "in_stock": {},
}


def ruled(folder: Path) -> Path:
    """A bow cuts one ruled face of a standing block."""
    return _write(folder, _straight(WALL))


def tapered(folder: Path) -> Path:
    """A bow cuts a face one end of which is half as long as the other, so that its kerf is wider there."""
    spec = {
        "name": "front",
        "start": {"bspline_mm": [[-80, -100, 62], [-80, -40, 68], [-80, 40, 66], [-80, 100, 60]]},
        "end": {"bspline_mm": [[80, -60, 66], [80, -20, 64], [80, 20, 68], [80, 60, 66]]},
        "flip": True,
    }
    fields = {"feed_mm_s": 8, "feed_min_mm_s": 2, "power_w": 40, "shape_tol_mm": 0.15, "step_mm": 2}
    return _write(folder, _straight({"ruled": [spec], "in_stock": {}}, **fields))


def ruled_file(folder: Path) -> Path:
    """A bow cuts a ruled face whose guide lines are in a DXF drawing."""
    import ezdxf

    drawing = ezdxf.new(units=4)
    for layer, x, heights in (("low", -80.0, (62, 74, 70, 58)), ("high", 80.0, (70, 64, 72, 66))):
        points = [(x, y, float(z)) for y, z in zip((-100, -33, 33, 100), heights, strict=True)]
        drawing.modelspace().add_polyline3d(points, dxfattribs={"layer": layer})
    drawing.saveas(folder / "guides.dxf")
    guide = {"file": "guides.dxf", "unit": "mm"}
    spec = {
        "name": "front",
        "start": {"dxf": {**guide, "layer": "low"}, "corner_deg": 60},
        "end": {"dxf": {**guide, "layer": "high"}, "corner_deg": 60},
        "flip": True,
    }
    return _write(folder, _straight({"ruled": [spec], "in_stock": {}}))


def ruled_rhino(folder: Path) -> Path:
    """A bow cuts a ruled face of a Rhino file in inches, whose normal is turned there."""
    model = Model("Inches")
    rails = [[(x / 25.4, y / 25.4, z / 25.4) for x, y, z in WALL["ruled"][0][side]["bspline_mm"]]
             for side in ("start", "end")]  # fmt: skip
    face = rhino3dm.Brep.CreateFromSurface(ruled_surface(*(curve(rail) for rail in rails), raised=2))
    face.Flip()
    model.add(face)
    model.write(folder / "wall.3dm")
    return _write(
        folder, _straight({"ruled": [{"name": "front", "rhino": {"file": "wall.3dm"}}], "in_stock": {}})
    )


def ruled_mesh(folder: Path) -> Path:
    """A bow cuts a ruled face that comes as a mesh of triangles."""
    u = np.linspace(-1.0, 1.0, 41)
    rows = []
    for x in np.linspace(-80.0, 80.0, 9):
        fraction = (x + 80.0) / 160.0
        low, high = 66.0 + 6.0 * np.cos(2.0 * u), 70.0 - 5.0 * u
        rows.append(
            np.stack([np.full_like(u, x), 100.0 * u, (1.0 - fraction) * low + fraction * high], axis=-1)
        )
    grid = np.array(rows)
    index = np.arange(grid.shape[0] * 41).reshape(-1, 41)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    trimesh.Trimesh(grid.reshape(-1, 3), faces, process=False).export(folder / "face.obj")
    part = {"mesh": {"file": "face.obj", "unit": "mm"}, "in_stock": {}}
    return _write(folder, _straight(part))


def plate(folder: Path) -> Path:
    """A bow cuts a plate with a hole, which it reaches through a slit."""
    outlines = [
        {"polyline_mm": [[-50, -40], [50, -40], [50, 20], [20, 40], [-50, 40]]},
        {"polyline_mm": [[-20, -15], [25, -15], [25, 15], [-20, 15]]},
    ]
    data = _straight({"plate": {"outlines": outlines}}, step_mm=2)
    data["stock"] = {
        "size_mm": [150, 120, 60],
        "foam": "eps_a120",
        "place": "auto",
        "roll_pitch_deg": [90, 0],
        "support": [{"kind": "box", "size_mm": [60, 500, 40], "pose": {"xyz_mm": [0, -310, 30]}}],
    }
    return _write(folder, data)


AIRFOIL: Final = "".join(
    f"{x:.5f} {y:.5f}\n"
    for x, y in [
        *((x, 0.3 * (x**0.5) * (1 - x) + 0.02 * x * (1 - x)) for x in np.linspace(1.0, 0.0, 31) ** 1.6),
        *((x, -0.12 * (x**0.5) * (1 - x)) for x in np.linspace(0.0, 1.0, 31)[1:] ** 1.6),
    ]
)


def wing(folder: Path) -> Path:
    """A bow cuts a short tapered wing between two sections, one of them from a file of points."""
    (folder / "root.dat").write_text("root\n" + AIRFOIL)
    part = {
        "wing": {
            "root": {"file": "root.dat", "chord_mm": 150},
            "tip": {"naca": "23112", "chord_mm": 110},
            "span_mm": 190,
            "sweep_deg": 6,
            "twist_deg": 2,
            "trailing_edge_mm": 0.8,
        }
    }
    data = _straight(part, cuts=[{"surface": "skin"}], step_mm=2)
    data["stock"]["size_mm"] = [220, 200, 80]
    return _write(folder, data)


SIDES: Final[dict[str, Any]] = {
    "name": "sides",
    "closed": True,
    "start": {"polyline_mm": [[84, 70, 0], [-76, 84, 0], [-84, -72, 0], [78, -80, 0]]},
    "end": {"polyline_mm": [[80, 78, 100], [-84, 76, 100], [-78, -82, 100], [86, -76, 100]]},
}
SIDE: Final[dict[str, Any]] = {
    "name": "side",
    **{end: {"polyline_mm": SIDES[end]["polyline_mm"][:2]} for end in ("start", "end")},
}


def held(folder: Path, surface: Mapping[str, Any] = SIDES) -> Path:
    """One arm holds the block and moves it, the other one cuts its sides with a bow."""
    data = _straight({"ruled": [surface], "in_stock": {}}, arms=["left", "right"])
    data["cell"] = _cell("two_irb140_bow_gripper")
    data["cell"]["arms"][1]["tool"] |= {"width_mm": 60, "depth_mm": 60}
    data["stock"] = {"size_mm": [210, 210, 100], "foam": "eps_a120", "held_by": "right"}
    return _write(folder, data)


def forming(folder: Path, mode: str = "spif", part: Mesh | None = None, **operation: Any) -> Path:
    """A dish of 60 mm is formed."""
    data = small_forming.problem(mode, **operation)
    if mode != "spif":
        data["sheet"]["place"] = UPRIGHT
    return small_forming.write(folder, data, part or small_forming.dish(around=180))


def oval(folder: Path) -> Path:
    """An oval dish, longer along x, is formed."""
    part = small_forming.dish(radius=26.0, around=180)
    return forming(folder, "spif", Mesh(part.vertices * [1.15, 1.0, 1.0], part.faces))


def forming_handshake(folder: Path) -> Path:
    """A dish by two arms with a controller each."""
    data = small_forming.problem("dsif", tangent_deg=3, handshake_gap_mm=10)
    data["cell"]["controller"] = {
        "tasks": ["T_ROB1"] * 2,
        "units": ["ROB_1"] * 2,
        "sync": "handshake",
        "handshake": {"every": 5},
    }
    data["sheet"]["place"] = UPRIGHT
    return small_forming.write(folder, data, small_forming.dish(around=180))


def tpif(folder: Path) -> Path:
    """A dome over a male die, its holder sinking."""
    part = small_forming.upside_down(small_forming.dish(around=180))
    data = small_forming.problem("tpif", die=small_forming.die(folder, part, "male", True))
    return small_forming.write(folder, data, part)


def two_features(folder: Path) -> Path:
    """A dish with a dome on its floor: two features, formed by tools that change their roles."""
    return forming(folder, "dsif", small_forming.dish_with_a_dome())


def flank(folder: Path, **cut: Any) -> Path:
    """A cylinder mills a twisted wall by its flank."""
    return small_mill.write(folder, small_mill.WALL, cuts=[{"flank": "wall", **cut}])


def lines(folder: Path) -> Path:
    """A ball nose finishes a curved panel in lines."""
    cuts = [{"lines": "front", "scallop_mm": 0.1}]
    return small_mill.write(folder, small_mill.PANEL, small_mill.BALL, cuts=cuts)


def engrave(folder: Path) -> Path:
    """A ball nose engraves a curve into a curved panel."""
    cuts = [{"engrave": [{"bspline_mm": [[-40, -20, 0], [-15, 20, 0], [15, -20, 0], [40, 20, 0]]}]}]
    cuts[0] |= {"name": "wave", "depth_mm": 1.0}
    return small_mill.write(folder, small_mill.PANEL, small_mill.BALL, cuts=cuts)


GCODE: Final = """\
%
G21 G90 G17 G94 G54
S9000 M3
G0 X-40 Y-20 Z5
G1 Z-1 F600
G1 X-10 F1500
G2 X10 Y-20 I10 J0
G3 X30 Y0 I0 J20
G91
G1 X5 Y5 Z-0.5
G90
G20
G1 X1 Y0.8
G21
G0 Z5
M30
%
"""


def gcode(folder: Path) -> Path:
    """A ball nose follows a file of G-code with arcs, inches, increments and an offset."""
    (folder / "marks.nc").write_text(GCODE)
    spec = {"file": "marks.nc", "origin": {"xyz_mm": [5, 3, 30]}, "offsets": {"G54": [2, 1, 0]}}
    cuts = [{"name": "marks", "gcode": spec}]
    return small_mill.write(folder, small_mill.PANEL, small_mill.BALL, cuts=cuts, part=None)


def gcode_rotary(folder: Path) -> Path:
    """A cylinder follows five-axis lines of a head that turns about C and A."""
    rows = ["G21 G90 G17 G94 S9000 M3", "G0 X-30 Y-30 Z30 A0 C0", "G1 X-30 Y-20 Z0 A10 C30 F1200"]
    rows += [f"X{-30 + 6 * k} Y{-20 + k} A{10 + 2 * k} C{30 + 5 * k}" for k in range(1, 9)]
    rows += ["G0 Z40", "M30"]
    (folder / "sides.nc").write_text("\n".join(rows) + "\n")
    spec = {
        "file": "sides.nc",
        "origin": {"xyz_mm": [0, 0, 30]},
        "tool_axis": "rotary",
        "convention": "head_ca",
    }
    cuts = [{"name": "sides", "gcode": spec}]
    return small_mill.write(folder, small_mill.PANEL, small_mill.BALL, cuts=cuts, part=None)


def gcode_ijk(folder: Path) -> Path:
    """A ball nose follows lines with the tool's axis by I J K."""
    rows = ["G21 G90 G17 G94 S9000 M3", "G0 X-30 Y0 Z20 I0 J0 K1", "G1 X-30 Y0 Z0 I0 J0 K1 F900"]
    rows += [f"X{-30 + 6 * k} Y{2 * k} I{0.01 * k:.2f} J{-0.01 * k:.2f} K1" for k in range(1, 9)]
    rows += ["G0 Z40", "M30"]
    (folder / "axis.nc").write_text("\n".join(rows) + "\n")
    spec = {"file": "axis.nc", "origin": {"xyz_mm": [0, 0, 30]}, "tool_axis": "ijk"}
    cuts = [{"name": "axis", "gcode": spec}]
    return small_mill.write(folder, small_mill.PANEL, small_mill.BALL, cuts=cuts, part=None)


def gcode_krl(folder: Path) -> Path:
    """The same file by a KUKA arm."""
    gcode(folder)
    data = yaml.safe_load((folder / "problem.yaml").read_text())
    tool = data["cell"]["arms"][0]["tool"]
    arm = {"name": "robot", "robot": "kr60_ha", "tool": tool, "home_deg": [0, -110, 110, 0, 40, 0]}
    controller = {"dialect": "krc4", "io": {"robot": {"doSpindle": 17}}}
    data["cell"] = {"name": "one", "arms": [arm], "controller": controller}
    data["stock"]["place"] = {"xyz_mm": [1350, 0, 700], "rpy_deg": [0, 0, 90]}
    return _write(folder, data)


SOFT: Final[dict[str, Any]] = {
    "joints_nm_rad": [1.1e5, 1.2e5, 0.9e5, 2e4, 2e4, 1.5e4],
    "source": "made up: softer than any robot of this size, for sag to be seen",
}


def sagging(path: Path, softer: float = 1.0, **forces: Any) -> Path:
    """The job of a file with arms whose sag is compensated, under ``forces`` {arm: [N, stock or tool]}."""
    data = yaml.safe_load(path.read_text())
    for arm in data["cell"]["arms"]:
        joints = [value / softer for value in SOFT["joints_nm_rad"]]
        arm |= {"stiffness": {**SOFT, "joints_nm_rad": joints}, "compensate_sag": {}}
    if forces:
        data["operations"][0]["forces"] = {
            arm: {"force_n": vector, "frame": frame} for arm, (vector, frame) in forces.items()
        }
    return _write(path.parent, data)


def turning(path: Path) -> Path:
    """A milling job with targets 2 mm apart, under a force that turns with the feed."""
    data = yaml.safe_load(path.read_text())
    data["operations"][0] |= {"step_mm": 2, "shape_tol_mm": 0.1}
    return sagging(_write(path.parent, data), 0.1, robot=([-60, 80, 30], "feed"))


DEEPER: Final[dict[str, list[list[float]]]] = {
    "left": [[8, 10, 0, 300], [6, 10, 0, 300], [3, 20, 0, 460], [-4, 30, 0, 600]],
    "right": [[-4, 0, 0, -150], [-5, 0, 0, -150], [-8, 0, 10, -240], [-12, 0, 10, -300]],
}
"""Forces of a forming job by z of the balls' centres."""


def deepening(path: Path) -> Path:
    """A forming job under forces that grow with depth."""
    data = yaml.safe_load(sagging(path, 0.1).read_text())
    data["operations"][0]["forces"] = {arm: {"table": rows} for arm, rows in DEEPER.items()}
    return _write(path.parent, data)


ROUND: Final = {"name": "round", "circle": {"at_mm": [0, 0], "diameter_mm": 16}}
"""A hole that a torch cuts."""
JOBS: Final[Mapping[str, Callable[[Path], Path]]] = {
    "posed": posed,
    "trim": lambda folder: small_forming.write(
        folder, small_trim.data(outlines=[ROUND]), small_forming.dish()
    ),
    "posed_two": lambda folder: posed(folder, 2),
    "gantry": gantry_job.write_problem,
    "gantry_krl": lambda folder: gantry_job.write_problem(folder, **gantry_job.KUKA),
    "posed_krl": lambda folder: posed(folder, 1, kuka=True),
    "handshake": lambda folder: posed(folder, 2, handshake=True),
    "handshake_ur": lambda folder: posed(folder, 2, handshake=True, ur=True),
    "elastic": elastic,
    "ruled": ruled,
    "ruled_file": ruled_file,
    "ruled_rhino": ruled_rhino,
    "ruled_mesh": ruled_mesh,
    "plate": plate,
    "wing": wing,
    "held": held,
    "held_side": lambda folder: held(folder, SIDE),
    "spif": forming,
    "oval": oval,
    "dsif": lambda folder: forming(folder, "dsif"),
    "dpif_l": lambda folder: forming(folder, "dpif_l"),
    "dpif_p": lambda folder: forming(folder, "dpif_p"),
    "adsif": lambda folder: forming(folder, "adsif", cone(25.0, 0.0025, 0.012, 96)),
    "adsif_small": lambda folder: forming(folder, "adsif", cone(25.0, 0.0015, 0.010, 72)),
    "heat": lambda folder: forming(folder, "heat"),
    "tpif": tpif,
    "two_features": two_features,
    "dsif_handshake": forming_handshake,
    "flank": flank,
    "lines": lines,
    "engrave": engrave,
    "gcode": gcode,
    "gcode_rotary": gcode_rotary,
    "gcode_ijk": gcode_ijk,
    "gcode_krl": gcode_krl,
    "behind": lambda folder: posed(folder, aside=0.5),
    "posed_fast": lambda folder: posed(folder, feed=900.0),
    "elastic_thin": lambda folder: elastic(folder, 0.8, 800.0, shape_tol_mm=0.3),
    "elastic_heat": lambda folder: elastic(folder, kerf_mm=None, power_w=80),
    "tapered": tapered,
    "dsif_squeezed": lambda folder: forming(folder, "dsif", squeeze=0.9),
    "dpif_l_shifted": lambda folder: forming(folder, "dpif_l", shift_deg=20),
    "posed_sag": lambda folder: sagging(
        posed(folder, 2), left=([30, -20, 60], "stock"), right=([0, 15, -50], "tool")
    ),
    "posed_sag_krl": lambda folder: sagging(posed(folder, kuka=True), left=([10, 0, 30], "stock")),
    "held_sag": lambda folder: sagging(held(folder), softer=12.0),
    "dsif_sag": lambda folder: sagging(
        forming(folder, "dsif"), 0.1, left=([20, 0, 300], "stock"), right=([0, 10, -200], "stock")
    ),
    "dsif_deep": lambda folder: deepening(forming(folder, "dsif")),
    "gcode_feed": lambda folder: turning(gcode(folder)),
    "gcode_feed_krl": lambda folder: turning(gcode_krl(folder)),
    "flank_rough": lambda folder: flank(folder, stepdown_mm=20),
}
"""The makers of all jobs, by name."""
