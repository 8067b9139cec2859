"""The 3D replay: one offline HTML file with arms, tools, block, the bent wire and a time bar.

Bodies move by poses at keyframes, between which the script interpolates linearly and by the shortest
rotation. A bent wire moves by its points. Cut surfaces are one mesh for each run of cuts, drawn up to the
present time. The script (`view3d/replay.js`) uses three.js, as the page of the service
does. Both are embedded in the file, and so are the quantities of the proof that colour the cut
(`cut_colours`).
"""

import base64
import dataclasses
import functools
import html
import http.server
import sys
import threading
import weakref
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse, spread_rows
from planner.geometry.units import MM
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.proof.verdict import Proof
from planner.report import cut_colour_layers, raster, released_sheet, view3d
from planner.report import scene as scenes
from planner.report.scene import DrawnSweep, Keyframes, sample_keyframes
from planner.report.time_bar import Clock, embed_json, replay_clock, time_bar

KEYFRAMES: Final = 480
"""Number of keyframes of a job with one operation."""
KEYFRAMES_PER_OPERATION: Final = 240
"""Number of keyframes of each further operation."""
TRIMMED_DEPTH_M: Final = 0.001
"""Depth [m] inside a trimmed block from which earlier cuts are drawn.

The cuts that trimmed it are its sides now, and would cover them.
"""
SWEPT_POINTS: Final = 25
"""Maximum number of points of a bent wire over which its cut surface is drawn."""
PATH_POINTS: Final = 2000
"""Maximum number of points, in each operation, of the drawn path of a tool that is not a linear cutter."""
PATH_SIDES: Final = 4
"""Number of sides of the rod that is drawn along the path of a tool that is not a linear cutter."""
PATH_RADIUS_FRACTION: Final = 0.004
"""Radius of that rod, as a fraction of the size of the initial view."""
BLOCK: Final = "block"
"""Name of the stock's frame among those of the replay."""
_EMBEDDED_FILES: Final = ("theme.css", "replay.css", "replay.js")


def replay_html(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> str:
    """Return the replay as one HTML file with all its scripts and data.

    Args:
        model: Cell model, for its robots and fixed bodies.
        problem: Problem.
        plan: Plan.
        proof: Proof, for the clock of its issues and the quantities that colour the cut, or None.
    """
    keyframes = sample_keyframes(
        problem, plan, KEYFRAMES + KEYFRAMES_PER_OPERATION * max(0, len(plan.operations) - 1)
    )
    clock = _program_clock(keyframes, proof)
    builder = _ReplayData()
    tips = _tips(problem, keyframes, _bodies(builder, model, problem, plan, keyframes))
    view = _view(model, problem, keyframes, tips)
    _add_cuts(builder, problem, plan, keyframes, float(np.ptp(np.array(view["work"]), axis=0).max()) * MM)
    all_times = builder.merge_times(keyframes.time - keyframes.time[0])
    layers = _layers(builder, problem, plan, proof, all_times, clock)
    theme, style, script = ((view3d.FOLDER / name).read_text("utf-8") for name in _EMBEDDED_FILES)
    data = {
        "time": builder.array(keyframes.time - keyframes.time[0]),
        "fine": builder.array(all_times),
        "setup": builder.array(keyframes.setup, np.uint16),
        "frames": builder.frames,
        "meshes": builder.meshes,
        "bodies": builder.bodies,
        "cuts": builder.cuts,
        "wire": _wire(builder, keyframes),
        "layers": layers,
        "targets": _target_times(builder, plan, keyframes),
        "view": view,
        "arrays": builder.packed(),
    }
    title = html.escape(f"{problem.name} – Tandem replay")
    names = ", ".join(f"{arm.name} ({arm.data.title})" for arm in problem.cell.arms)
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{title}</title><style>{theme}{style}</style></head><body>"
        f"<header><h1 class='unseen'>{title}</h1>{_toolbar(layers)}</header>"
        "<main><canvas id='scene' tabindex='0' role='img' "
        f"aria-label='3D view of {html.escape(names, quote=True)} at work. Arrow keys rotate, + and - zoom, "
        "0 resets the view.'></canvas><div id='labels' aria-hidden='true'></div>"
        "<section id='key' aria-label='Colours along the cut' hidden></section>"
        f"{released_sheet.sheet_switch(plan)}"
        "<p id='none' hidden>This browser cannot show 3D views: it lacks WebGL 2.</p></main>"
        f"<footer>{time_bar(problem.name, keyframes, clock, plan.duration or None)}</footer>"
        f"{embed_json('film', data)}<script>{view3d.three_js()}</script>"
        f"<script>{view3d.bundle_script(script, view3d.FILM_MODULES)}</script></body></html>\n"
    )


def _toolbar(layers: Sequence[dict[str, Any]]) -> str:
    """Return the HTML of the toolbar above the picture, with a choice of colours if there are layers."""
    choices = "".join(f"<option value='{i}'>{layer['name']}</option>" for i, layer in enumerate(layers))
    colours = (
        "<label><span>Colours</span><select id='colours'><option value=''>none</option>"
        f"{choices}</select></label>"
        if layers
        else ""
    )
    return (
        "<div id='tools' role='toolbar' aria-label='View'>"
        "<button type='button' id='follow' aria-pressed='false' title='The view follows the tool (f)'>"
        "Follow tool</button>"
        "<button type='button' id='home' title='Show the work (0)'>Work</button>"
        "<button type='button' id='whole' title='Show the whole cell (w)'>Cell</button>"
        "<button type='button' id='measure' aria-pressed='false' title='Distance between two points (m)'>"
        f"Measure</button>{colours}<span id='measured' role='status'></span>"
        "<button type='button' id='theme'></button></div>"
    )


@dataclasses.dataclass(frozen=True)
class Viewer:
    """A replay that is served at ``url`` as long as this value exists.

    A notebook shows ``page``, the replay of a result folder, which needs neither this process nor a
    network.
    """

    url: str
    page: str = dataclasses.field(repr=False)

    def _repr_html_(self) -> str:
        style = 'width="100%" height="560" style="border:0"'
        return f'<iframe srcdoc="{html.escape(self.page)}" {style}></iframe>'


class _OnePage(http.server.BaseHTTPRequestHandler):
    """HTTP handler that answers with one page."""

    def __init__(self, page: bytes, *request: Any) -> None:
        self.page = page
        super().__init__(*request)

    def do_GET(self) -> None:
        """Send the page, whatever the path."""
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.page)))
        self.end_headers()
        self.wfile.write(self.page)

    def log_message(self, *_: Any) -> None:
        """Log nothing."""


def in_notebook() -> bool:
    """Report whether this process is a Jupyter kernel, in which a value is shown by its `_repr_html_`."""
    if "IPython" not in sys.modules:
        return False
    import IPython

    return getattr(IPython.get_ipython(), "kernel", None) is not None


def show(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> Viewer:
    """Return the replay as a page, and serve it to this machine only, as long as the result exists.

    Args:
        model: Cell model.
        problem: Problem.
        plan: Plan.
        proof: Proof, or None.
    """
    page = replay_html(model, problem, plan, proof)
    handler = functools.partial(_OnePage, page.encode())
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True).start()
    viewer = Viewer(f"http://127.0.0.1:{server.server_address[1]}/", page)
    weakref.finalize(viewer, _close, server).atexit = False  # the daemon thread ends with the process
    return viewer


def _close(server: http.server.ThreadingHTTPServer) -> None:
    """Stop a server and release its port."""
    server.shutdown()
    server.server_close()


def _program_clock(keyframes: Keyframes, proof: Proof | None) -> Clock:
    """Return corresponding times of programs and replay. Empty if the proof has no clock."""
    series = proof.series if proof is not None else {}
    if "time" not in series or "label" not in series:
        return ()
    return replay_clock(keyframes, np.asarray(series["time"]), [str(label) for label in series["label"]])


ArrayReference = tuple[str, int, int]
"""Location of an array in the bytes of a page: its NumPy type without byte order, first byte, and length."""


class _ReplayData:
    """Builder of the data of a page in mm: arrays as bytes, frames, meshes, bodies, cut surfaces."""

    def __init__(self) -> None:
        self.bytes = bytearray()
        self.frames: list[dict[str, Any]] = []
        self.meshes: list[list[ArrayReference]] = []
        self.bodies: list[dict[str, Any]] = []
        self.cuts: list[dict[str, Any]] = []
        self.mesh_numbers: dict[bytes, int] = {}

    def array(self, values: Any, kind: Any = np.float32) -> ArrayReference:
        """Append an array to the bytes, little-endian and flat, and return its location."""
        flat = np.asarray(values).astype(np.dtype(kind).newbyteorder("<")).ravel()
        self.bytes += bytes(-len(self.bytes) % 4)  # typed arrays of JavaScript must be aligned
        start = len(self.bytes)
        self.bytes += flat.tobytes()
        return np.dtype(kind).str[1:], start, len(flat)

    def packed(self) -> str:
        """Return all arrays as base64 text."""
        return base64.b64encode(bytes(self.bytes)).decode()

    def frame(self, name: str, poses: FloatArray) -> None:
        """Add a frame with poses (T, 4, 4) [m] at the keyframes, stored as positions and quaternions."""
        is_fixed = np.abs(poses - poses[0]).max() < 1e-9
        poses_to_store = poses[:1] if is_fixed else poses
        quaternions = Rotation.from_matrix(poses_to_store[:, :3, :3]).as_quat()
        self.frames.append(
            {"name": name, "poses": self.array(np.hstack([poses_to_store[:, :3, 3] / MM, quaternions]))}
        )

    def mesh(self, vertices: FloatArray, faces: IntArray) -> int:
        """Store a mesh (V, 3) [m], (F, 3) unless an equal one is stored, and return its number."""
        points = np.round(vertices / MM, 3).astype(np.float32)
        key = points.tobytes() + b"|" + np.asarray(faces).astype(np.uint32).tobytes()
        if key not in self.mesh_numbers:
            self.mesh_numbers[key] = len(self.meshes)
            self.meshes.append([self.array(points), self.indices(faces, len(points))])
        return self.mesh_numbers[key]

    def indices(self, faces: IntArray, count: int) -> ArrayReference:
        """Append indices into ``count`` vertices, in 16 bits if these suffice, and return their location."""
        return self.array(faces, np.uint16 if count < 65_536 else np.uint32)

    def merge_times(self, time: FloatArray) -> FloatArray:
        """Return the ascending union of the times (T,) [s] of keyframes and of those of all cut surfaces.

        ``keys`` of the cut surfaces become indices into the result.
        """
        times_by_cut = [np.asarray(cut["keys"]) for cut in self.cuts]
        all_times = np.unique(np.concatenate([time, *times_by_cut]))
        for cut, cut_times in zip(self.cuts, times_by_cut, strict=True):
            cut["keys"] = self.array(np.searchsorted(all_times, cut_times), np.uint32)
        return all_times

    def body(self, frame: str, kind: str, piece: scenes.VisiblePiece, seen: BoolArray | None = None) -> None:
        """Add a piece that moves with a frame and is visible at the keyframes ``seen`` (T,), or always."""
        solid = piece.solid.moved(piece.pose)
        color = None if kind in ("stock", "edge", "support") else [round(float(v), 4) for v in piece.color]
        mesh = self.mesh(solid.vertices, solid.faces)
        self.bodies.append({"body": frame, "kind": kind, "color": color, "mesh": mesh} | _runs_of(seen))


def _runs_of(seen: BoolArray | None) -> dict[str, Any]:
    """Return the first keyframe and the end of each interval in which something is visible.

    Empty if it is always visible, for which ``seen`` may be None.
    """
    if seen is None or seen.all():
        return {}
    edges = np.flatnonzero(np.diff(np.concatenate([[0], seen.astype(int), [0]])))
    return {"seen": edges.reshape(-1, 2).tolist()}


def _bodies(
    builder: _ReplayData, model: CellModel, problem: Problem, plan: Plan, keyframes: Keyframes
) -> dict[str, FloatArray]:
    """Add robots, fixed bodies, tools, blocks and the nominal part.

    Tools, blocks and supports are visible in the setups that have them. Those of equal shape are added once.

    Returns:
        World poses {body: (T, 4, 4)} of the arms' links and tools and of fixed bodies.
    """
    scene = scenes.extract_scene(model)
    poses = scenes.poses_on_axes(
        scene, problem.setups, keyframes.setup, scene.poses(keyframes.q), keyframes.axis_values
    )
    obstacles = {body.name for body in problem.cell.obstacles}
    for piece in scene.pieces:
        builder.body(piece.body, "obstacle" if piece.body in obstacles else "link", piece)
    for body in poses:
        builder.frame(body, poses[body])
    builder.frame(BLOCK, keyframes.block)
    groups: dict[tuple[str, int], tuple[list[scenes.VisiblePiece], BoolArray]] = {}
    for index, setup in enumerate(problem.setups):
        for name, pieces in _pieces_by_body(setup, plan.stock_poses[index]).items():
            key = next(
                (k for k, (other, _) in groups.items() if k[0] == name and _have_same_shapes(other, pieces)),
                None,
            )
            group = groups.setdefault(
                key or (name, index), (pieces, np.zeros(len(keyframes.time), dtype=bool))
            )
            group[1][keyframes.setup == index] = True
    for pieces, seen in groups.values():
        for piece in pieces:
            role = piece.body.rpartition("/")[2]
            frame = BLOCK if role in ("stock", "support") else piece.body.replace("/edge", "/tool")
            builder.body(frame, role, piece, seen)
    for _, mesh in raster.part_meshes(problem.part):
        number = builder.mesh(mesh.vertices, mesh.faces)
        builder.bodies.append({"body": BLOCK, "kind": "part", "color": None, "mesh": number})
    _add_remaining_stock(builder, problem, plan, keyframes)
    return poses


def _add_remaining_stock(builder: _ReplayData, problem: Problem, plan: Plan, keyframes: Keyframes) -> None:
    """Add the stocks that remain after operations, each visible from the end of its work to the next one."""
    remaining: list[tuple[int, int]] = []
    for index, operation in enumerate(plan.operations):
        for exhibit in operation.targets.exhibits.values():
            if isinstance(exhibit, Mapping) and exhibit.get("kind") == "left":
                operation_keyframes = np.flatnonzero(keyframes.operation == index)
                works = [k for k in operation_keyframes.tolist() if keyframes.segment[k].works]
                mesh = builder.mesh(np.asarray(exhibit["vertices"]), np.asarray(exhibit["faces"]))
                remaining += [(works[-1], mesh)] if works else []
    keys = np.arange(len(keyframes.time))
    for number, (first, mesh) in enumerate(remaining):
        end = remaining[number + 1][0] if number + 1 < len(remaining) else len(keys)
        seen = _runs_of((keys > first) & (keys <= end))
        builder.bodies.append({"body": BLOCK, "kind": "part", "color": None, "mesh": mesh} | seen)


def _pieces_by_body(setup: Setup, stock_pose: FloatArray) -> dict[str, list[scenes.VisiblePiece]]:
    """Return the pieces that a setup adds to the cell, by body."""
    out: dict[str, list[scenes.VisiblePiece]] = {}
    for piece in scenes.setup_pieces(setup, stock_pose):
        out.setdefault(piece.body, []).append(piece)
    return out


def _have_same_shapes(first: list[scenes.VisiblePiece], second: list[scenes.VisiblePiece]) -> bool:
    """Report whether two lists of pieces have equal vertices in the frame of their body."""
    return len(first) == len(second) and all(
        a.solid.vertices.shape == b.solid.vertices.shape
        and np.allclose(a.solid.moved(a.pose).vertices, b.solid.moved(b.pose).vertices, atol=1e-9)
        for a, b in zip(first, second, strict=True)
    )


def _tips(problem: Problem, keyframes: Keyframes, poses: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the TCP of each arm in the world (T, 3) [m] at the keyframes."""
    out = {}
    for arm in problem.cell.arms:
        tools = [setup.cell.arm(arm.name).tool.tcp for setup in problem.setups]
        out[arm.name] = (poses[f"{arm.name}/tool"] @ np.stack(tools)[keyframes.setup])[:, :3, 3]
    return out


def _view(
    model: CellModel, problem: Problem, keyframes: Keyframes, tips: dict[str, FloatArray]
) -> dict[str, Any]:
    """Return the data with which the 3D view chooses its first view and follows the tools.

    ``work``: lower and upper corner [mm] of the box of block and tools in the first operation that works;
    ``turn`` and ``lift``: direction [rad] to the camera, across the line of the bases, or of base and block;
    ``tips`` {arm}: TCP [mm] in the flange frame in each setup; ``arms`` of each operation; ``operation``:
    first keyframe and index of each run of an operation.
    """
    works = np.array([segment.works for segment in keyframes.segment])
    first = int(np.flatnonzero(works)[0]) if works.any() else 0
    block = keyframes.block[first]
    working_arms = problem.operations[int(keyframes.operation[first])].arms
    base_positions = [model.bases[arm][:3, 3] for arm in working_arms]
    line = ((base_positions[1] if len(base_positions) > 1 else block[:3, 3]) - base_positions[0]) * np.array(
        [1.0, 1.0, 0.0]
    )
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    to_camera = 0.92 * np.array([line[1], -line[0], 0.0]) - 0.2 * line + np.array([0.0, 0.0, 0.45])
    stock = problem.setups[int(keyframes.setup[first])].stock
    corners = np.array(np.meshgrid(*np.stack([stock.lower, stock.upper], axis=1))).reshape(3, -1).T
    in_operation = works & (keyframes.operation == keyframes.operation[first])
    shown = [corners @ block[:3, :3].T + block[:3, 3], *(tips[arm][in_operation] for arm in working_arms)]
    box = np.concatenate(shown)
    setups = problem.setups
    return {
        "work": np.round(np.stack([box.min(axis=0), box.max(axis=0)]) / MM, 1).tolist(),
        "turn": round(float(np.arctan2(to_camera[1], to_camera[0])), 4),
        "lift": round(float(np.arctan2(to_camera[2], np.hypot(to_camera[0], to_camera[1]))), 4),
        "tips": {
            arm.name: [
                np.round(setup.cell.arm(arm.name).tool.tcp[:3, 3] / MM, 3).tolist() for setup in setups
            ]
            for arm in problem.cell.arms
        },
        "arms": [list(operation.arms) for operation in problem.operations],
        "operation": [[int(k), int(keyframes.operation[k])] for k in _change_indices(keyframes.operation)],
    }


def _change_indices(values: IntArray) -> IntArray:
    """Return the indices at which a run of equal values starts, the first one included."""
    return (
        np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1]) if len(values) else np.zeros(0, np.int64)
    )


def _wire(builder: _ReplayData, keyframes: Keyframes) -> dict[str, Any] | None:
    """Return the points of the wire at the keyframes, their number and a visible radius [mm], or None."""
    if keyframes.wire is None:
        return None
    radius = max(keyframes.wire_radius, scenes.MIN_WIRE_RADIUS_M) / MM
    count = int(keyframes.wire.shape[1])
    return {"points": builder.array(keyframes.wire / MM), "count": count, "radius": radius} | _runs_of(
        keyframes.shown
    )


def _add_cuts(builder: _ReplayData, problem: Problem, plan: Plan, keyframes: Keyframes, size: float) -> None:
    """Add the cuts to the replay: surfaces that wires and linear cutters sweep in the block, else rods.

    An operation without such a surface gets a rod along the path of its tool. The thickness of the rod
    follows from the ``size`` [m] of the view. Cuts are also shown in later setups. If the block has another
    size there, cuts are drawn only within that block.
    """
    blocks = [setup.stock for setup in problem.setups]
    for cut in keyframes.sweeps:
        cut_block = blocks[cut.setup]
        setups_with_block = [
            k for k, block in enumerate(blocks) if k >= cut.setup and raster.have_same_size(block, cut_block)
        ]
        _add_sweep(builder, cut, cut_block.lower, cut_block.upper, keyframes, setups_with_block)
        for k in range(cut.setup + 1, len(blocks)):
            if k not in setups_with_block:
                lower, upper = blocks[k].lower + TRIMMED_DEPTH_M, blocks[k].upper - TRIMMED_DEPTH_M
                _add_sweep(builder, cut, lower, upper, keyframes, [k])
    swept = {int(keyframes.operation[cut.keys[-1]]) for cut in keyframes.sweeps}
    for index, (start, operation) in enumerate(zip(keyframes.starts, plan.operations, strict=True)):
        target_indices = spread_rows(len(operation.time), PATH_POINTS)
        works = np.array([operation.targets.segment[k].works for k in target_indices])
        if index in swept or not works.any():
            continue
        setup = problem.setup_of(index)
        bases = scenes.bases_at_targets(
            setup, {**plan.bases, **scenes.axis_bases(setup)}, operation, target_indices
        )
        q = {name: joints[target_indices] for name, joints in operation.q.items()}
        to_block = inverse(scenes.block_pose(setup, plan.stock_poses[setup.number - 1], bases, q))
        time = operation.time[target_indices] - operation.time[0] + start - keyframes.time[0]
        for name in operation.targets.arms:
            if setup.stock.held_by != name:
                arm = setup.cell.arm(name)
                tip = (to_block @ scenes.flange_poses(arm, bases, q[name]) @ arm.tool.tcp)[:, :3, 3]
                _add_rod(builder, name, tip, time, works, PATH_RADIUS_FRACTION * size)


def _add_sweep(
    builder: _ReplayData,
    cut: DrawnSweep,
    lower: FloatArray,
    upper: FloatArray,
    keyframes: Keyframes,
    setups: Sequence[int],
) -> None:
    """Add the surface of a cut within a box of the stock frame [m], visible in some setups."""
    points = cut.points
    if points.shape[1] == 2:
        points = raster.clip_wires(points, lower, upper)
    else:
        points = points[:, spread_rows(points.shape[1], SWEPT_POINTS)]
    centres = 0.25 * (points[:-1, :-1] + points[1:, :-1] + points[:-1, 1:] + points[1:, 1:])
    with np.errstate(invalid="ignore"):
        inside = ((centres >= lower - 1e-9) & (centres <= upper + 1e-9)).all(axis=2)
    time = keyframes.time[cut.keys] - keyframes.time[0]
    _add_surface(builder, "", points, time, np.asarray(inside), np.isin(keyframes.setup, setups))


def _add_rod(
    builder: _ReplayData, arm: str, tip: FloatArray, time: FloatArray, works: BoolArray, radius: float
) -> None:
    """Add a rod about the path of a TCP (K, 3) [m] at ``time`` (K,) [s], where the tool works (K,)."""
    direction = np.gradient(tip, axis=0) if len(tip) > 1 else np.zeros_like(tip)
    z = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    reference = np.where(np.abs(z[:, 2:3]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    x = np.cross(reference, z)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    angle = np.linspace(0.0, 2.0 * np.pi, PATH_SIDES + 1)[:, None]
    circle = np.cos(angle)[None] * x[:, None] + np.sin(angle)[None] * np.cross(z, x)[:, None]
    inside = np.repeat(works[1:, None], PATH_SIDES, axis=1)
    _add_surface(builder, arm, tip[:, None] + radius * circle, time, inside, None)


def _add_surface(
    builder: _ReplayData,
    arm: str,
    points: FloatArray,
    time: FloatArray,
    inside: BoolArray,
    seen: BoolArray | None,
) -> None:
    """Add a surface of those quads between points (K, P, 3) [m] in the stock frame that are ``inside``.

    ``inside`` is (K-1, P-1). The surface grows with ``time`` (K,) [s], and has the colours of the arm at
    these times, or of all arms together for an empty name. It is visible at the keyframes ``seen`` (T,).
    """
    if not inside.any():
        return
    count = points.shape[1]
    row, column = np.nonzero(inside)
    a = row * count + column
    quads = np.stack([a, a + 1, a + count + 1, a, a + count + 1, a + count], axis=1)
    # number of indices (two triangles of three for each quad) to draw up to each row of points
    index_counts = np.cumsum(np.bincount(row, minlength=len(time) - 1)) * 6
    builder.cuts.append(
        {
            "arm": arm,
            "per": count,
            "vertices": builder.array(np.nan_to_num(points) / MM),
            "faces": builder.indices(quads, points.shape[0] * count),
            "keys": time,
            "upto": builder.array(np.concatenate([[0], index_counts]), np.uint32),
        }
        | _runs_of(seen)
    )


def _target_times(builder: _ReplayData, plan: Plan, keyframes: Keyframes) -> dict[str, Any]:
    """Return the times of all targets, and pairs of first target and name of each run of a segment."""
    times, runs, first_target = [], [], 0
    for start, operation in zip(keyframes.starts, plan.operations, strict=True):
        segments = operation.targets.segment
        for i, segment in enumerate(segments):
            if i == 0 or segment != segments[i - 1]:
                runs.append([first_target + i, str(segment)])
        times.append(operation.time - operation.time[0] + start - keyframes.time[0])
        first_target += len(segments)
    return {"times": builder.array(np.concatenate(times) if times else np.zeros(0)), "runs": runs}


def _layers(
    builder: _ReplayData, problem: Problem, plan: Plan, proof: Proof | None, times: FloatArray, clock: Clock
) -> list[dict[str, Any]]:
    """Return the quantities that colour the cut at times (T,) [s] of the replay. Empty without a clock."""
    if not clock:
        return []
    program_times, replay_times = np.array(clock).T
    time = np.interp(times, replay_times, program_times)
    out = []
    for layer in cut_colour_layers.colour_layers(problem, plan, proof, time):
        fields: dict[str, Any] = {
            "name": layer.name,
            "title": layer.title,
            "unit": layer.unit,
            "low": round(layer.low, 4),
            "high": round(layer.high, 4),
            "key": ["#" + "".join(f"{round(255 * float(c)):02x}" for c in shade) for shade in layer.key],
            "limits": [[round(value, 4), word] for value, word in layer.limits],
            "words": layer.words,
            "values": {arm: builder.array(values) for arm, values in layer.values.items()},
            "colours": {arm: _bytes(builder, colours) for arm, colours in layer.colours.items()},
        }
        if len(layer.points):
            fields["points"] = builder.array(layer.points / MM)
            fields["spacing"] = round(layer.spacing / MM, 3)
            fields["point_colours"] = _bytes(builder, layer.point_colours)
        out.append(fields)
    return out


def _bytes(builder: _ReplayData, colours: FloatArray) -> ArrayReference:
    """Store colours in 0..1 as bytes, and return their location."""
    return builder.array(np.clip(np.round(255.0 * colours), 0, 255), np.uint8)
