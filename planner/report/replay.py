"""The 3D replay: one offline HTML file with arms, tools, block, the bending wire and a time bar.

Bodies move by poses at keyframes, which the page's script takes straight lines and shortest turns between;
a bent wire by its points. What has been cut is one surface for each run of cuts, of which the part up to now
is drawn. The script (`view3d/replay.js`) draws by three.js as the page of the service does; both are inside
the file, and so are the figures of the proof by which the cut is coloured (`cut_colours`).
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
from planner.report import cut_colours, raster, released_sheet, view3d
from planner.report import scene as scenes
from planner.report.scene import Sweep, Track, track
from planner.report.time_bar import Clock, embedded, replay_clock, time_bar

KEYFRAMES: Final = 480
"""Keyframes of a job of one operation."""
KEYFRAMES_MORE: Final = 240
"""Keyframes of each further operation."""
TRIMMED_DEPTH_M: Final = 0.001
"""How far [m] inside a block that was trimmed earlier cuts are still drawn: those that trimmed it are now its
sides."""
SWEPT_POINTS: Final = 25
"""Points of a wire over which the surface that it cuts is drawn."""
PATH_POINTS: Final = 2000
"""Points of the way of a tool that cuts along no line, in each operation."""
PATH_SIDES: Final = 4
"""Sides of the rod that is drawn along the way of a tool that cuts along no line."""
PATH_SHARE: Final = 0.004
"""Radius of that rod over the size of what is shown at first."""
BLOCK: Final = "block"
"""Name of the frame of the stock."""
_FILES: Final = ("theme.css", "replay.css", "replay.js")


def document(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> str:
    """The replay as text. ``model``: the cell, for its robots and fixed bodies; a ``proof`` has the clock
    that its issues are told by, and the figures that the cut is coloured by."""
    run = track(problem, plan, KEYFRAMES + KEYFRAMES_MORE * max(0, len(plan.operations) - 1))
    clock = _clock(run, proof)
    film = _Film()
    tips = _tips(problem, run, _bodies(film, model, problem, plan, run))
    view = _view(model, problem, run, tips)
    _cuts(film, problem, plan, run, float(np.ptp(np.array(view["work"]), axis=0).max()) * MM)
    fine = film.settle(run.time - run.time[0])
    layers = _layers(film, problem, plan, proof, fine, clock)
    theme, style, script = ((view3d.FOLDER / name).read_text("utf-8") for name in _FILES)
    data = {
        "time": film.array(run.time - run.time[0]),
        "fine": film.array(fine),
        "setup": film.array(run.setup, np.uint16),
        "frames": film.frames,
        "meshes": film.meshes,
        "bodies": film.bodies,
        "cuts": film.cuts,
        "wire": _wire(film, run),
        "layers": layers,
        "targets": _target_times(film, plan, run),
        "view": view,
        "arrays": film.packed(),
    }
    title = html.escape(f"{problem.name} – Tandem replay")
    names = ", ".join(f"{arm.name} ({arm.data.title})" for arm in problem.cell.arms)
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{title}</title><style>{theme}{style}</style></head><body>"
        f"<header><h1 class='unseen'>{title}</h1>{_tools(layers)}</header>"
        "<main><canvas id='scene' tabindex='0' role='img' "
        f"aria-label='3D view of {html.escape(names, quote=True)} at work. Arrow keys turn it, + and - zoom, "
        "0 goes back to the work.'></canvas><div id='labels' aria-hidden='true'></div>"
        f"<section id='key' aria-label='Colours along the cut' hidden></section>{released_sheet.switch(plan)}"
        "<p id='none' hidden>This browser draws no 3D (WebGL 2).</p></main>"
        f"<footer>{time_bar(problem.name, run, clock, plan.duration or None)}</footer>"
        f"{embedded('film', data)}<script>{view3d.three()}</script>"
        f"<script>{view3d.script(script, view3d.FILM_MODULES)}</script></body></html>\n"
    )


def _tools(layers: Sequence[dict[str, Any]]) -> str:
    """The row of controls above the picture."""
    choices = "".join(f"<option value='{i}'>{one['name']}</option>" for i, one in enumerate(layers))
    colours = (
        "<label><span>Colours</span><select id='colours'><option value=''>none</option>"
        f"{choices}</select></label>"
        if layers
        else ""
    )
    return (
        "<div id='tools' role='toolbar' aria-label='View'>"
        "<button type='button' id='follow' aria-pressed='false' title='The view goes with the tool (f)'>"
        "Follow tool</button>"
        "<button type='button' id='home' title='Look at the work (0)'>Work</button>"
        "<button type='button' id='whole' title='Look at the whole cell (w)'>Cell</button>"
        "<button type='button' id='measure' aria-pressed='false' title='Distance between two points (m)'>"
        f"Measure</button>{colours}<span id='measured' role='status'></span>"
        "<button type='button' id='theme'></button></div>"
    )


@dataclasses.dataclass(frozen=True)
class Viewer:
    """A plan in a browser at ``url`` for as long as this value lives. A notebook shows it in its cell by
    ``page``, the replay that a result folder has, which needs neither this process nor a network."""

    url: str
    page: str = dataclasses.field(repr=False)

    def _repr_html_(self) -> str:
        style = 'width="100%" height="560" style="border:0"'
        return f'<iframe srcdoc="{html.escape(self.page)}" {style}></iframe>'


class _OnePage(http.server.BaseHTTPRequestHandler):
    """Answers with one page."""

    def __init__(self, page: bytes, *more: Any) -> None:
        self.page = page
        super().__init__(*more)

    def do_GET(self) -> None:
        """The page, whatever the path."""
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.page)))
        self.end_headers()
        self.wfile.write(self.page)

    def log_message(self, *_: Any) -> None:
        """Nothing is logged."""


def in_notebook() -> bool:
    """Whether a kernel of Jupyter runs this, whose cells show values by their HTML."""
    if "IPython" not in sys.modules:
        return False
    import IPython

    return getattr(IPython.get_ipython(), "kernel", None) is not None


def show(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> Viewer:
    """The replay as a page, and served to this machine alone."""
    page = document(model, problem, plan, proof)
    handler = functools.partial(_OnePage, page.encode())
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True).start()
    viewer = Viewer(f"http://127.0.0.1:{server.server_address[1]}/", page)
    weakref.finalize(viewer, _close, server).atexit = False  # its thread ends with the process
    return viewer


def _close(server: http.server.ThreadingHTTPServer) -> None:
    server.shutdown()
    server.server_close()


def _clock(run: Track, proof: Proof | None) -> Clock:
    series = proof.series if proof is not None else {}
    if "time" not in series or "label" not in series:
        return ()
    return replay_clock(run, np.asarray(series["time"]), [str(label) for label in series["label"]])


Reference = tuple[str, int, int]
"""Where an array lies among the bytes of a page: its kind, first byte, number of values."""


class _Film:
    """What a page holds, gathered: arrays as bytes, frames that move, meshes, bodies, surfaces of cuts."""

    def __init__(self) -> None:
        self.bytes = bytearray()
        self.frames: list[dict[str, Any]] = []
        self.meshes: list[list[Reference]] = []
        self.bodies: list[dict[str, Any]] = []
        self.cuts: list[dict[str, Any]] = []
        self.known: dict[bytes, int] = {}

    def array(self, values: Any, kind: Any = np.float32) -> Reference:
        """Puts an array among the bytes, little-endian and flat."""
        flat = np.asarray(values).astype(np.dtype(kind).newbyteorder("<")).ravel()
        self.bytes += bytes(-len(self.bytes) % 4)
        start = len(self.bytes)
        self.bytes += flat.tobytes()
        return np.dtype(kind).str[1:], start, len(flat)

    def packed(self) -> str:
        """All arrays as text."""
        return base64.b64encode(bytes(self.bytes)).decode()

    def frame(self, name: str, poses: FloatArray) -> None:
        """A frame that stands or moves by poses (T, 4, 4): places [mm] and quaternions."""
        still = np.abs(poses - poses[0]).max() < 1e-9
        own = poses[:1] if still else poses
        turns = Rotation.from_matrix(own[:, :3, :3]).as_quat()
        self.frames.append({"name": name, "poses": self.array(np.hstack([own[:, :3, 3] / MM, turns]))})

    def mesh(self, vertices: FloatArray, faces: IntArray) -> int:
        """The number of a mesh [m]; equal ones are kept once."""
        points = np.round(vertices / MM, 3).astype(np.float32)
        key = points.tobytes() + b"|" + np.asarray(faces).astype(np.uint32).tobytes()
        if key not in self.known:
            self.known[key] = len(self.meshes)
            self.meshes.append([self.array(points), self.indices(faces, len(points))])
        return self.known[key]

    def indices(self, faces: IntArray, count: int) -> Reference:
        """Indices of fewer than ``count`` vertices."""
        return self.array(faces, np.uint16 if count < 65_536 else np.uint32)

    def settle(self, time: FloatArray) -> FloatArray:
        """The times (S,) [s] of all rows of the surfaces, and of the keyframes, by which ``keys`` count."""
        rows = [np.asarray(cut["keys"]) for cut in self.cuts]
        fine = np.unique(np.concatenate([time, *rows]))
        for cut, own in zip(self.cuts, rows, strict=True):
            cut["keys"] = self.array(np.searchsorted(fine, own), np.uint32)
        return fine

    def body(self, frame: str, kind: str, piece: scenes.Piece, seen: BoolArray | None = None) -> None:
        """A piece that goes along with a frame, seen at some keyframes."""
        solid = piece.solid.moved(piece.pose)
        color = None if kind in ("stock", "edge", "support") else [round(float(v), 4) for v in piece.color]
        mesh = self.mesh(solid.vertices, solid.faces)
        self.bodies.append({"body": frame, "kind": kind, "color": color, "mesh": mesh} | _runs_of(seen))


def _runs_of(seen: BoolArray | None) -> dict[str, Any]:
    """From which keyframe to before which one a thing is seen; nothing where always."""
    if seen is None or seen.all():
        return {}
    edges = np.flatnonzero(np.diff(np.concatenate([[0], seen.astype(int), [0]])))
    return {"seen": edges.reshape(-1, 2).tolist()}


def _bodies(film: _Film, model: CellModel, problem: Problem, plan: Plan, run: Track) -> dict[str, FloatArray]:
    """Robots and fixed bodies, tools and blocks of all setups, each shown in the setups that have it; gives
    the poses (T, 4, 4) of bodies and tools back."""
    scene = scenes.extract(model)
    poses = scenes.ridden(scene, problem.setups, run.setup, scene.poses(run.q), run.stands)
    obstacles = {body.name for body in problem.cell.obstacles}
    for piece in scene.pieces:
        film.body(piece.body, "obstacle" if piece.body in obstacles else "link", piece)
    for body in poses:
        film.frame(body, poses[body])
    film.frame(BLOCK, run.block)
    sets: dict[tuple[str, int], tuple[list[scenes.Piece], BoolArray]] = {}
    for index, setup in enumerate(problem.setups):
        for name, pieces in _groups(setup, plan.places[index]).items():
            key = next(
                (k for k, (known, _) in sets.items() if k[0] == name and _same_looks(known, pieces)), None
            )
            found = sets.setdefault(key or (name, index), (pieces, np.zeros(len(run.time), dtype=bool)))
            found[1][run.setup == index] = True
    for pieces, seen in sets.values():
        for piece in pieces:
            last = piece.body.rpartition("/")[2]
            frame = BLOCK if last in ("stock", "support") else piece.body.replace("/edge", "/tool")
            film.body(frame, last, piece, seen)
    for _, mesh in raster.part_meshes(problem.part):
        number = film.mesh(mesh.vertices, mesh.faces)
        film.bodies.append({"body": BLOCK, "kind": "part", "color": None, "mesh": number})
    _left(film, problem, plan, run)
    return poses


def _left(film: _Film, problem: Problem, plan: Plan, run: Track) -> None:
    """Stocks as operations leave them, each from the end of its work on, until the next one is shown."""
    found: list[tuple[int, int]] = []
    for index, operation in enumerate(plan.operations):
        for one in operation.targets.exhibits.values():
            if isinstance(one, Mapping) and one.get("kind") == "left":
                own = np.flatnonzero(run.operation == index)
                works = [k for k in own.tolist() if run.segment[k].works]
                mesh = film.mesh(np.asarray(one["vertices"]), np.asarray(one["faces"]))
                found += [(works[-1], mesh)] if works else []
    keys = np.arange(len(run.time))
    for number, (first, mesh) in enumerate(found):
        end = found[number + 1][0] if number + 1 < len(found) else len(keys)
        seen = _runs_of((keys > first) & (keys <= end))
        film.bodies.append({"body": BLOCK, "kind": "part", "color": None, "mesh": mesh} | seen)


def _groups(setup: Setup, place: FloatArray) -> dict[str, list[scenes.Piece]]:
    out: dict[str, list[scenes.Piece]] = {}
    for piece in scenes.mounted(setup, place):
        out.setdefault(piece.body, []).append(piece)
    return out


def _same_looks(one: list[scenes.Piece], other: list[scenes.Piece]) -> bool:
    return len(one) == len(other) and all(
        a.solid.vertices.shape == b.solid.vertices.shape
        and np.allclose(a.solid.moved(a.pose).vertices, b.solid.moved(b.pose).vertices, atol=1e-9)
        for a, b in zip(one, other, strict=True)
    )


def _tips(problem: Problem, run: Track, poses: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Tips (T, 3) [m] of the tools in the world."""
    out = {}
    for arm in problem.cell.arms:
        tools = [one.cell.arm(arm.name).tool.tcp for one in problem.setups]
        out[arm.name] = (poses[f"{arm.name}/tool"] @ np.stack(tools)[run.setup])[:, :3, 3]
    return out


def _view(model: CellModel, problem: Problem, run: Track, tips: dict[str, FloatArray]) -> dict[str, Any]:
    """How the view begins: ``work``, the corners [mm] of the box of block and tools where they first work,
    seen across the line of the bases, or of the base and the block; ``tips`` {arm} of tools in their frames
    in each setup, ``arms`` of each operation, and from which keyframe which ``operation`` is done."""
    works = np.array([segment.works for segment in run.segment])
    first = int(np.flatnonzero(works)[0]) if works.any() else 0
    block = run.block[first]
    busy = problem.operations[int(run.operation[first])].arms
    places = [model.bases[arm][:3, 3] for arm in busy]
    line = ((places[1] if len(places) > 1 else block[:3, 3]) - places[0]) * np.array([1.0, 1.0, 0.0])
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    eye = 0.92 * np.array([line[1], -line[0], 0.0]) - 0.2 * line + np.array([0.0, 0.0, 0.45])
    stock = problem.setups[int(run.setup[first])].stock
    corners = np.array(np.meshgrid(*np.stack([stock.lower, stock.upper], axis=1))).reshape(3, -1).T
    own = works & (run.operation == run.operation[first])
    seen = [corners @ block[:3, :3].T + block[:3, 3], *(tips[arm][own] for arm in busy)]
    box = np.concatenate(seen)
    setups = problem.setups
    return {
        "work": np.round(np.stack([box.min(axis=0), box.max(axis=0)]) / MM, 1).tolist(),
        "turn": round(float(np.arctan2(eye[1], eye[0])), 4),
        "lift": round(float(np.arctan2(eye[2], np.hypot(eye[0], eye[1]))), 4),
        "tips": {
            arm.name: [np.round(one.cell.arm(arm.name).tool.tcp[:3, 3] / MM, 3).tolist() for one in setups]
            for arm in problem.cell.arms
        },
        "arms": [list(operation.arms) for operation in problem.operations],
        "operation": [[int(k), int(run.operation[k])] for k in _changes(run.operation)],
    }


def _changes(values: IntArray) -> IntArray:
    return (
        np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1]) if len(values) else np.zeros(0, np.int64)
    )


def _wire(film: _Film, run: Track) -> dict[str, Any] | None:
    """The wire that joins the arms: its points [mm] at the keyframes, drawn thick enough to be seen."""
    if run.wire is None:
        return None
    radius = max(run.wire_radius, scenes.LEAST_WIRE_RADIUS_M) / MM
    count = int(run.wire.shape[1])
    return {"points": film.array(run.wire / MM), "count": count, "radius": radius} | _runs_of(run.shown)


def _cuts(film: _Film, problem: Problem, plan: Plan, run: Track, size: float) -> None:
    """What wires and cutters sweep within the block while they cut; for other tools a rod, as thick as suits
    the ``size`` [m] of the view, along the way of their tips over the stock.

    In later setups, in which the block may have become smaller, cuts are drawn as far as it goes then.
    """
    blocks = [setup.stock for setup in problem.setups]
    for cut in run.sweeps:
        own = blocks[cut.setup]
        kept = [k for k, block in enumerate(blocks) if k >= cut.setup and raster.same_size(block, own)]
        _sweep(film, cut, own.lower, own.upper, run, kept)
        for k in range(cut.setup + 1, len(blocks)):
            if k not in kept:
                lower, upper = blocks[k].lower + TRIMMED_DEPTH_M, blocks[k].upper - TRIMMED_DEPTH_M
                _sweep(film, cut, lower, upper, run, [k])
    swept = {int(run.operation[cut.keys[-1]]) for cut in run.sweeps}
    for index, (start, operation) in enumerate(zip(run.starts, plan.operations, strict=True)):
        rows = spread_rows(len(operation.time), PATH_POINTS)
        works = np.array([operation.targets.segment[k].works for k in rows])
        if index in swept or not works.any():
            continue
        setup = problem.setup_of(index)
        bases = scenes.riding(setup, {**plan.bases, **scenes.standing(setup)}, operation, rows)
        q = {name: own[rows] for name, own in operation.q.items()}
        to_block = inverse(scenes.block_pose(setup, plan.places[setup.number - 1], bases, q))
        time = operation.time[rows] - operation.time[0] + start - run.time[0]
        for name in operation.targets.arms:
            if setup.stock.held_by != name:
                arm = setup.cell.arm(name)
                tip = (to_block @ scenes.flange_poses(arm, bases, q[name]) @ arm.tool.tcp)[:, :3, 3]
                _rod(film, name, tip, time, works, PATH_SHARE * size)


def _sweep(
    film: _Film, cut: Sweep, lower: FloatArray, upper: FloatArray, run: Track, setups: Sequence[int]
) -> None:
    points = cut.points
    if points.shape[1] == 2:
        points = raster.clipped_wires(points, lower, upper)
    else:
        points = points[:, spread_rows(points.shape[1], SWEPT_POINTS)]
    middle = 0.25 * (points[:-1, :-1] + points[1:, :-1] + points[:-1, 1:] + points[1:, 1:])
    with np.errstate(invalid="ignore"):
        inside = ((middle >= lower - 1e-9) & (middle <= upper + 1e-9)).all(axis=2)
    time = run.time[cut.keys] - run.time[0]
    _grid(film, "", points, time, np.asarray(inside), np.isin(run.setup, setups))


def _rod(film: _Film, arm: str, tip: FloatArray, time: FloatArray, works: BoolArray, radius: float) -> None:
    """A rod about the way of a tip (K, 3) at ``time`` (K,) [s], where it works on the way there."""
    way = np.gradient(tip, axis=0) if len(tip) > 1 else np.zeros_like(tip)
    z = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    aside = np.where(np.abs(z[:, 2:3]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    x = np.cross(aside, z)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    turn = np.linspace(0.0, 2.0 * np.pi, PATH_SIDES + 1)[:, None]
    round_ = np.cos(turn)[None] * x[:, None] + np.sin(turn)[None] * np.cross(z, x)[:, None]
    inside = np.repeat(works[1:, None], PATH_SIDES, axis=1)
    _grid(film, arm, tip[:, None] + radius * round_, time, inside, None)


def _grid(
    film: _Film, arm: str, points: FloatArray, time: FloatArray, inside: BoolArray, seen: BoolArray | None
) -> None:
    """A surface over points (K, P, 3) [m] in the stock frame, of the quads that are ``inside`` (K-1, P-1); it
    grows with ``time`` (K,) [s], and has the colours of an arm at these times, or of all together."""
    if not inside.any():
        return
    count = points.shape[1]
    row, column = np.nonzero(inside)
    a = row * count + column
    quads = np.stack([a, a + 1, a + count + 1, a, a + count + 1, a + count], axis=1)
    upto = np.cumsum(np.bincount(row, minlength=len(time) - 1)) * 6
    film.cuts.append(
        {
            "arm": arm,
            "per": count,
            "vertices": film.array(np.nan_to_num(points) / MM),
            "faces": film.indices(quads, points.shape[0] * count),
            "keys": time,
            "upto": film.array(np.concatenate([[0], upto]), np.uint32),
        }
        | _runs_of(seen)
    )


def _target_times(film: _Film, plan: Plan, run: Track) -> dict[str, Any]:
    """When the arms are at the targets, and the names of their runs of one segment with the first of each."""
    times, runs, first = [], [], 0
    for start, operation in zip(run.starts, plan.operations, strict=True):
        segments = operation.targets.segment
        for i, segment in enumerate(segments):
            if i == 0 or segment != segments[i - 1]:
                runs.append([first + i, str(segment)])
        times.append(operation.time - operation.time[0] + start - run.time[0])
        first += len(segments)
    return {"times": film.array(np.concatenate(times) if times else np.zeros(0)), "runs": runs}


def _layers(
    film: _Film, problem: Problem, plan: Plan, proof: Proof | None, fine: FloatArray, clock: Clock
) -> list[dict[str, Any]]:
    """The figures that the cut is coloured by, as the page has them."""
    if not clock:
        return []
    told, shown = np.array(clock).T
    time = np.interp(fine, shown, told)
    out = []
    for one in cut_colours.layers(problem, plan, proof, time):
        own: dict[str, Any] = {
            "name": one.name,
            "title": one.title,
            "unit": one.unit,
            "low": round(one.low, 4),
            "high": round(one.high, 4),
            "key": ["#" + "".join(f"{round(255 * float(c)):02x}" for c in shade) for shade in one.key],
            "limits": [[round(value, 4), word] for value, word in one.limits],
            "words": one.words,
            "values": {arm: film.array(values) for arm, values in one.values.items()},
            "colours": {arm: _bytes(film, colours) for arm, colours in one.colours.items()},
        }
        if len(one.points):
            own["points"] = film.array(one.points / MM)
            own["spacing"] = round(one.spacing / MM, 3)
            own["point_colours"] = _bytes(film, one.point_colours)
        out.append(own)
    return out


def _bytes(film: _Film, colours: FloatArray) -> Reference:
    return film.array(np.clip(np.round(255.0 * colours), 0, 255), np.uint8)
