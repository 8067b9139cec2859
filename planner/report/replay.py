"""The 3D replay: one offline HTML file with arms, tools, block, the bending wire and a time bar.

Written by Drake's Meshcat as static HTML. Rigid bodies move by transforms, and so does the wire, as
a chain of capsules, because animated lines keep only their last state. What has been cut appears
strip by strip. The bar at the foot has play, time, segments, stops and speed, and drives Meshcat's
animation.
"""

from __future__ import annotations

import dataclasses
import html
import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Capsule, Meshcat, MeshcatAnimation, MeshcatParams, Rgba

from planner.cell.plant import CellModel, quiet, rigid
from planner.claims.vocabulary import Segment
from planner.geometry.arrays import BoolArray, FloatArray, Mesh, spread_rows
from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.report import raster, released_sheet
from planner.report import scene as scenes
from planner.report.scene import MOTION_TIME, SETUP_SEGMENT, TRAVEL_TIME, Track, track
from planner.verify.result import Proof

_SEGMENT_COLOURS: Final = {
    "cut": "#f08a3c",
    "mill": "#f08a3c",
    "trim": "#f08a3c",
    "form": "#f08a3c",
    "approach": "#58a6c7",
    "retreat": "#58a6c7",
    "link": "#58a6c7",
    "transit": "#7d9fc0",
    "entry": "#aab4c0",
    "exit": "#aab4c0",
    "setup": "#c9a2c4",
}
"""Colours of the time bar by kind of segment."""
_OTHER_COLOUR: Final = "#8d99a8"
"""Colour of the time bar for every other kind of segment."""
Clock = tuple[tuple[float, float], ...]
"""Times of the programs and of the replay [s] that belong together, ascending; straight between them."""

_STYLE: Final = """
#status-message{display:none!important}.dg.ac{z-index:3}
#bar{position:fixed;left:16px;right:16px;bottom:14px;z-index:4;background:rgba(255,255,255,.93);border-radius:12px;
padding:10px 16px 12px;font:14px/1.35 "Inter","Segoe UI",system-ui,-apple-system,Arial,sans-serif;
color:#1b2330;
box-shadow:0 4px 18px rgba(20,30,45,.18);display:grid;grid-template-columns:auto 1fr auto;gap:4px 14px;
align-items:center}
#bar button,#bar select{font:inherit;border:0;background:#e8edf2;color:inherit;border-radius:8px;
height:34px;cursor:pointer}
#bar button{width:42px;font-size:15px}#bar select{padding:0 6px}
#bar .line{position:relative;height:34px;touch-action:none;cursor:pointer}
#bar .seg{position:absolute;top:13px;height:8px}#bar .seg:first-child{border-radius:4px 0 0 4px}
#bar .stop{position:absolute;top:8px;width:2px;height:18px;background:#c0352b}
#bar .knob{position:absolute;top:7px;width:20px;height:20px;margin-left:-10px;border-radius:50%;
background:#fff;
border:3px solid #0f6e84;box-shadow:0 1px 4px rgba(0,0,0,.3);box-sizing:border-box}
#bar .say{grid-column:1/4;display:flex;gap:10px 22px;flex-wrap:wrap;color:#4d596a;
font-size:13px;min-height:18px}
#bar .say b{color:#1b2330;font-variant-numeric:tabular-nums}
#bar .say i{display:inline-block;width:10px;height:10px;
border-radius:3px;margin-right:6px}
"""
"""Style of the time bar."""

_SCRIPT: Final = """
(()=>{const D=JSON.parse(document.getElementById('track').textContent),T=D.end,
 bar=document.getElementById('bar'),
 q=s=>bar.querySelector(s),line=q('.line'),knob=q('.knob'),play=q('button'),speed=q('select');
 let t=0,going=false,last=0,drag=false;
 for(const [a,b,name,color] of D.segments){const e=document.createElement('div');e.className='seg';
e.title=name;
  e.style.cssText=`left:${100*a/T}%;width:${100*(b-a)/T}%;background:${color}`;line.prepend(e)}
 for(const [a,text] of D.stops){const e=document.createElement('div');e.className='stop';e.title=text;
  e.style.left=`${100*a/T}%`;line.append(e)}
 line.append(knob);
 const clock=s=>`${Math.floor(s/60)}:${(s%60).toFixed(1).padStart(4,'0')}`;
 const draw=()=>{knob.style.left=`${100*t/T}%`;
  const s=D.segments.find(v=>t>=v[0]&&t<=v[1])||D.segments[D.segments.length-1];
  q('.time').textContent=`${clock(t)} / ${clock(T)}`;q('.segment').textContent=s?s[2]:'';
q('.say i').style.background=s?s[3]:'';
  const near=D.stops.filter(v=>Math.abs(v[0]-t)<Math.max(T*.004,.05));
q('.stopped').textContent=near.map(v=>v[1]).join(' · ')};
 const go=v=>{t=Math.min(Math.max(v,0),T);
if(window.viewer){for(const a of viewer.animator.actions){a.paused=false;a.enabled=true}
  viewer.animator.seek(t)}draw()};
 const set=v=>{going=v;play.textContent=v?'\\u275A\\u275A':'\\u25B6';last=performance.now()};
 play.onclick=()=>{if(!going&&t>=T)go(0);set(!going)};
 const at=e=>{const r=line.getBoundingClientRect();go((e.clientX-r.left)/r.width*T)};
 line.onpointerdown=e=>{drag=true;line.setPointerCapture(e.pointerId);at(e)};
 line.onpointermove=e=>{if(drag)at(e)};line.onpointerup=()=>{drag=false};
 addEventListener('keydown',e=>{if(e.code==='Space'){e.preventDefault();play.onclick()}
  if(e.code==='ArrowRight')go(t+T/200);if(e.code==='ArrowLeft')go(t-T/200)});
 const onReplay=v=>{const c=D.clock,k=c.findIndex(p=>p[0]>=v);if(!c.length)return v;
  if(k<1)return c[k?c.length-1:0][1];const [a,b]=[c[k-1],c[k]];
return a[1]+(b[1]-a[1])*(v-a[0])/Math.max(b[0]-a[0],1e-9)};
 const inWork=(v,name)=>{const n=Math.max(D.segments.findIndex(s=>s[2]===name),0),
  before=D.segments.slice(0,n+1).filter(s=>s[2]==='entry'||s[2]==='setup').pop();
return (before?before[1]:0)+v};
 const asked=()=>{const h=new URLSearchParams(location.hash.slice(1)),
  n=k=>h.has(k)&&isFinite(h.get(k))?+h.get(k):null;
  const [t,at,work]=['t','at','work'].map(n);
return t!==null?t:at!==null?onReplay(at):work!==null?inWork(work,h.get('in')):null},start=asked();
 addEventListener('hashchange',()=>{const v=asked();if(v!==null){set(false);go(v)}});
 const step=now=>{if(going&&!drag){go(t+(now-last)/1000*speed.value);if(t>=T)set(false)}last=now;
requestAnimationFrame(step)};
 const ready=()=>{if(window.viewer&&viewer.animator&&viewer.animator.duration>0){
   if(viewer.gui)viewer.gui.close();viewer.animator.play();viewer.animator.pause();
go(start??0);if(start===null)set(true);
   requestAnimationFrame(step)}else setTimeout(ready,60)};
 draw();ready()})();
"""
"""Script of the time bar, which drives the animation of Meshcat."""


def time_bar(name: str, run: Track, clock: Clock = (), motion_time: float | None = None) -> str:
    """HTML of the bar for an animation that starts at time 0; with ``motion_time`` [s], which the report
    states, it says how much of its own time is what.

    ``#t=seconds`` in the address stops there, also when it changes; ``#at=`` is a time on the programs'
    clock, which ``clock`` leads over; ``#work=`` one from the start of the work of the operation that has the
    segment ``in=``.
    """
    time = run.time - run.time[0]
    end = float(max(time[-1], 1e-3))
    data = {
        "end": round(end, 3),
        "segments": [(a, b, str(one), colour) for a, b, one, colour in _segments(time, run.segment)],
        "clock": [(round(a, 3), round(b, 3)) for a, b in clock],
        "stops": [(round(at - float(run.time[0]), 3), text) for at, text in run.stops],
    }
    packed = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    best = min((1, 2, 4, 8, 16, 32), key=lambda v: abs(np.log(end / v / 45.0)))
    options = "".join(
        f'<option value="{v}"{" selected" if v == best else ""}>{v:g} ×</option>'
        for v in (0.5, 1, 2, 4, 8, 16, 32)
    )
    return (
        f"<style>{_STYLE}</style><div id='bar'>"
        "<button title='play or pause (space)'>▶</button><div class='line'>"
        f"<div class='knob'></div></div><select title='speed'>{options}</select>"
        f"<div class='say'><span><b>{html.escape(name)}</b></span><span><span class='time'></span>"
        f"{_shares(end, run, motion_time)}</span>"
        "<span><i></i><span class='segment'></span></span>"
        "<span class='stopped' style='color:#c0352b'></span></div></div>"
        f"<script type='application/json' id='track'>{packed}</script><script>{_SCRIPT}</script>"
    )


def _shares(end: float, run: Track, motion_time: float | None) -> str:
    """What the time ``end`` [s] of a replay consists of; the report's ``motion_time`` [s] is a part of it."""
    if motion_time is None or end - motion_time < 0.05:
        return ""
    rest = "ways from and to home"
    rest += " and changes of setup" if SETUP_SEGMENT in run.segment else ""
    travel = f"{_clock_time(run.travel)} {TRAVEL_TIME}, " if run.travel else ""
    left = end - motion_time - run.travel
    return f": {_clock_time(motion_time)} {MOTION_TIME}, {travel}{_clock_time(left)} {rest}"


def _clock_time(seconds: float) -> str:
    """A time as the bar shows it: minutes, and seconds to a tenth."""
    tenths = round(10.0 * seconds)
    return f"{tenths // 600}:{tenths % 600 / 10:04.1f}"


def replay_clock(run: Track, time: FloatArray, labels: Sequence[str]) -> Clock:
    """How the programs' clock, ``time`` (S,) [s] with the ``labels`` (S,) of what is done (keys of
    segments), leads to the replay's: what has the same label in both begins and ends together, and so does
    the whole.

    The replay shows the ways from and to home at a pace of its own, so the clocks differ by more than a
    shift.
    """
    shown = [(one, a, b) for a, b, one, _ in _segments(run.time - run.time[0], run.segment)]
    out: list[tuple[float, float]] = []
    for label, first, last in _runs(labels):
        found = next((i for i, one in enumerate(shown) if one[0].key == label), None)
        if found is not None:
            _, start, end = shown[found]
            shown = shown[found + 1 :]
            out += [(float(time[max(first - 1, 0)]), start), (float(time[last]), end)]
    if not out:
        return ()
    return ((float(time[0]), 0.0), *out, (float(time[-1]), float(run.time[-1] - run.time[0])))


def _runs(labels: Sequence[str]) -> list[tuple[str, int, int]]:
    """Runs of equal labels: label, first and last index."""
    edges = [i for i in range(1, len(labels)) if labels[i] != labels[i - 1]]
    return [
        (str(labels[a]), a, b - 1)
        for a, b in zip([0, *edges], [*edges, len(labels)], strict=True)
        if len(labels)
    ]


def _segments(time: np.ndarray, segments: tuple[Segment, ...]) -> list[tuple[float, float, Segment, str]]:
    """Runs of one segment: start, end, segment, colour; it belongs to the way to its keyframe."""
    out: list[tuple[float, float, Segment, str]] = []
    for i in range(1, len(segments)):
        a, b = round(float(time[i - 1]), 3), round(float(time[i]), 3)
        if out and out[-1][2] == segments[i]:
            out[-1] = (out[-1][0], b, *out[-1][2:])
        else:
            out.append((a, b, segments[i], _SEGMENT_COLOURS.get(segments[i].kind, _OTHER_COLOUR)))
    return out


FRAMES_PER_S: Final = 100.0
"""Frames [1/s] of the animation, which its keyframes are rounded to."""
KEYFRAMES: Final = 480
"""Keyframes of a job of one operation."""
KEYFRAMES_MORE: Final = 240
"""Keyframes of each further operation."""
STRIPS: Final = 120
"""Strips of cut surface that appear one after the other, in all."""
TRIMMED_DEPTH_M: Final = 0.001
"""How far [m] inside a block that was trimmed earlier cuts are still drawn: those that trimmed it are now its
sides."""
WIRE_LINKS: Final = 28
"""Capsules of the chain that a bent wire is drawn as."""
BLOCK_PATH: Final = "/block"
"""Where the block stands in the tree of Meshcat."""
_CUT_COLOUR: Final = Rgba(1.0, 0.66, 0.36, 1.0)
"""Colour of what has been cut."""
_BLOCK_COLOUR: Final = Rgba(0.97, 0.91, 0.66, 0.42)
"""Colour of the block, which is seen through."""
_PART_COLOUR: Final = Rgba(0.16, 0.56, 0.62, 1.0)
"""Colour of the wanted part."""


def document(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> str:
    """The replay as text. ``model``: the cell, for its robots and fixed bodies; a ``proof`` has the clock
    that its issues are told by.

    Raises :class:`TandemError` (``report.replay_failed``) if Meshcat cannot start.
    """
    meshcat, run = _filmed(model, problem, plan)
    return _page(meshcat, run, problem, plan, proof)


def _page(meshcat: Any, run: Track, problem: Problem, plan: Plan, proof: Proof | None) -> str:
    """The replay as text, of the Meshcat that shows it."""
    page = str(meshcat.StaticHtml())
    title = f"{problem.name} – Tandem replay"
    bar = time_bar(problem.name, run, _clock(run, proof), plan.duration or None)
    page = page.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>")
    return page.replace("</body>", f"{bar}{released_sheet.switch(plan)}</body>", 1)


def _filmed(model: CellModel, problem: Problem, plan: Plan) -> tuple[Any, Track]:
    """A Meshcat that shows the plan, and what it shows; raises as :func:`document`."""
    try:
        with quiet():
            meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    except RuntimeError as error:
        issue = Issue("report.replay_failed", f"Meshcat, which writes replay.html, cannot start: {error}")
        raise TandemError(issue) from error
    run = track(problem, plan, KEYFRAMES + KEYFRAMES_MORE * max(0, len(plan.operations) - 1))
    animation = MeshcatAnimation(FRAMES_PER_S)
    film = _Film(meshcat, animation, np.round((run.time - run.time[0]) * FRAMES_PER_S).astype(int))
    _set_view(meshcat, model, run)
    _bodies(film, model, problem, plan.places, run)
    _parts(meshcat, problem)
    _left(film, problem, plan, run)
    if run.wire is not None:
        _wire(film, run.wire, run.shown, run.wire_radius)
    _strips(film, problem, run)
    animation.set_autoplay(False)
    animation.set_repetitions(1)
    meshcat.SetAnimation(animation)
    return meshcat, run


@dataclasses.dataclass(frozen=True)
class Viewer:
    """A plan in a browser at ``url`` for as long as this value lives. A notebook shows it in its cell by
    ``page``, the replay that a result folder has, which needs neither this process nor a network."""

    url: str
    meshcat: Any
    page: str = dataclasses.field(repr=False)

    def _repr_html_(self) -> str:
        style = 'width="100%" height="560" style="border:0"'
        return f'<iframe srcdoc="{html.escape(self.page)}" {style}></iframe>'


def in_notebook() -> bool:
    """Whether a kernel of Jupyter runs this, whose cells show values by their HTML."""
    if "IPython" not in sys.modules:
        return False
    import IPython

    return getattr(IPython.get_ipython(), "kernel", None) is not None


def show(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> Viewer:
    """The replay in a server of Meshcat on this machine, with its animation under "Animations", and as a
    page. Raises as :func:`document`."""
    meshcat, run = _filmed(model, problem, plan)
    return Viewer(str(meshcat.web_url()), meshcat, _page(meshcat, run, problem, plan, proof))


def _clock(run: Track, proof: Proof | None) -> Clock:
    series = proof.series if proof is not None else {}
    if "time" not in series or "label" not in series:
        return ()
    return replay_clock(run, np.asarray(series["time"]), [str(label) for label in series["label"]])


@dataclasses.dataclass(frozen=True)
class _Film:
    """Meshcat, its animation, and the frame (T,) of each key."""

    meshcat: Any
    animation: Any
    frames: NDArray[np.int_]

    def move(self, path: str, poses: FloatArray) -> None:
        """Keys (T, 4, 4) for a thing; keys between two equal neighbours say nothing and are left out."""
        self.meshcat.SetTransform(path, rigid(poses[0]))
        moved = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2)) > 1e-9
        if not moved.any():
            return
        keep = np.concatenate([[True], moved]) | np.concatenate([moved, [True]])
        for i in np.flatnonzero(keep):
            self.animation.SetTransform(int(self.frames[i]), path, rigid(poses[i]))

    def show(self, path: str, seen: BoolArray) -> None:
        """Shows and hides a thing by keys (T,)."""
        if seen.all():
            return
        self.meshcat.SetProperty(path, "visible", bool(seen[0]))
        self.animation.SetProperty(0, path, "visible", bool(seen[0]))
        for i in np.flatnonzero(np.diff(seen.astype(int))) + 1:
            self.animation.SetProperty(int(self.frames[i]), path, "visible", bool(seen[i]))


def _set_view(meshcat: Any, model: CellModel, run: Track) -> None:
    """Background, camera across the line of the bases, or of the base and the block; no axes."""
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [0.74, 0.78, 0.83])
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Grid", "visible", True)
    places = np.array([model.bases[arm][:3, 3] for arm in model.arms])
    reach = max(robot.reach for robot in model.robots.values())
    block = run.block[:, :3, 3]
    ends = places if len(places) > 1 else np.stack([places[0], block.mean(axis=0)])
    line = (ends[-1] - ends[0]) * np.array([1.0, 1.0, 0.0])
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    seen = np.concatenate([places, places + np.array([0.0, 0.0, 0.85 * reach]), block])
    target = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    spread = float(np.linalg.norm(seen - target, axis=1).max()) + 0.6 * reach
    across = np.array([line[1], -line[0], 0.0])
    target[2] -= 0.10 * spread  # the bar takes the foot of the picture
    eye = target + 0.92 * spread * across - 0.2 * spread * line + np.array([0.0, 0.0, 0.35 * spread])
    meshcat.SetCameraPose(eye, target)


def _bodies(
    film: _Film, model: CellModel, problem: Problem, places: Sequence[FloatArray], run: Track
) -> None:
    """Robots and fixed bodies, tools and blocks of all setups, each shown in the setups that have it."""
    scene = scenes.extract(model)
    poses = scenes.ridden(scene, problem.setups, run.setup, scene.poses(run.q), run.stands)
    for number, piece in enumerate(scene.pieces):
        _object(film, f"/cell/{piece.body}/{number}", piece)
    for body in scene.bodies():
        film.move(f"/cell/{body}", poses[body])
    for arm in model.arms:
        film.move(f"/cell/{arm}/tool", poses[f"{arm}/tool"])
    film.move(BLOCK_PATH, run.block)
    sets: dict[str, tuple[list[scenes.Piece], BoolArray]] = {}
    for index, setup in enumerate(problem.setups):
        for name, pieces in _groups(setup, places[index]).items():
            path = next(
                (p for p, (known, _) in sets.items() if p.startswith(name) and _same_looks(known, pieces)), ""
            )
            path = path or f"{name}/{index}"
            seen = sets.setdefault(path, (pieces, np.zeros(len(run.time), dtype=bool)))[1]
            seen |= run.setup == index
    for path, (pieces, seen) in sets.items():
        for number, piece in enumerate(pieces):
            _object(film, f"{path}/{number}", piece)
        film.show(path, seen)


def _groups(setup: Setup, place: FloatArray) -> dict[str, list[scenes.Piece]]:
    """Pieces of a setup by the path of what they move with."""
    out: dict[str, list[scenes.Piece]] = {}
    for piece in scenes.mounted(setup, place):
        arm, _, kind = piece.body.partition("/")
        out.setdefault(f"/cell/{arm}/tool" if kind else f"{BLOCK_PATH}/{piece.body}", []).append(piece)
    return out


def _same_looks(one: list[scenes.Piece], other: list[scenes.Piece]) -> bool:
    """Whether two groups look the same."""
    return len(one) == len(other) and all(
        a.body == b.body
        and a.solid.vertices.shape == b.solid.vertices.shape
        and np.allclose(a.solid.moved(a.pose).vertices, b.solid.moved(b.pose).vertices, atol=1e-9)
        for a, b in zip(one, other, strict=True)
    )


def _object(film: _Film, path: str, piece: scenes.Piece) -> None:
    film.meshcat.SetObject(path, piece.shape, _BLOCK_COLOUR if piece.body == "stock" else Rgba(*piece.color))
    film.meshcat.SetTransform(path, rigid(piece.pose))


def _parts(meshcat: Any, problem: Problem) -> None:
    """The wanted surfaces, which move with the block."""
    for name, mesh in raster.part_meshes(problem.part):
        _surface(meshcat, f"{BLOCK_PATH}/wanted/{name}", mesh, _PART_COLOUR)


def _left(film: _Film, problem: Problem, plan: Plan, run: Track) -> None:
    """Stocks as operations leave them, each from the end of its work on, until the next one is shown."""
    found: list[tuple[int, Mesh]] = []
    for index, operation in enumerate(plan.operations):
        for one in operation.targets.exhibits.values():
            if isinstance(one, Mapping) and one.get("kind") == "left":
                own = np.flatnonzero(run.setup == scenes.setup_index(problem, index))
                works = [k for k in own.tolist() if run.segment[k].works]
                mesh = Mesh(np.asarray(one["vertices"]), np.asarray(one["faces"]))
                found += [(works[-1], mesh)] if works else []
    keys = np.arange(len(run.time))
    for number, (first, mesh) in enumerate(found):
        end = found[number + 1][0] if number + 1 < len(found) else len(keys)
        path = f"{BLOCK_PATH}/left/{number}"
        _surface(film.meshcat, path, mesh, _PART_COLOUR)
        film.show(path, (keys > first) & (keys <= end))


def _surface(meshcat: Any, path: str, mesh: Mesh, color: Rgba) -> None:
    """A surface that can be seen from both sides."""
    both = np.concatenate([mesh.faces, mesh.faces[:, ::-1]])
    meshcat.SetTriangleMesh(path, mesh.vertices.T, both.T.astype(np.int32), color)


def _wire(film: _Film, wire: FloatArray, shown: BoolArray, radius: float) -> None:
    """A chain of capsules along the wire (T, P, 3), drawn thick enough to be seen."""
    points = wire[:, spread_rows(wire.shape[1], WIRE_LINKS + 1)]
    step = np.diff(points, axis=1)
    length = np.linalg.norm(step, axis=-1)
    poses = _poses_along(0.5 * (points[:, 1:] + points[:, :-1]), step)
    for k in range(step.shape[1]):
        path = f"/wire/{k}"
        shape = Capsule(max(radius, scenes.LEAST_WIRE_RADIUS_M), float(np.median(length[shown, k])))
        film.meshcat.SetObject(path, shape, Rgba(*scenes.HOT_COLOUR))
        film.move(path, poses[:, k])
    film.show("/wire", shown)


def _poses_along(middle: FloatArray, direction: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) at ``middle`` with z along ``direction``."""
    z = direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
    aside = np.where(np.abs(z[..., 2:3]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    x = np.cross(aside, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    pose = np.zeros((*z.shape[:-1], 4, 4))
    pose[..., :3, 0], pose[..., :3, 1], pose[..., :3, 2] = x, np.cross(z, x), z
    pose[..., :3, 3], pose[..., 3, 3] = middle, 1.0
    return pose


def _strips(film: _Film, problem: Problem, run: Track) -> None:
    """What wires sweep within the block while they cut, as strips that appear when they are cut and stay.

    In later setups, in which the block may have become smaller, they are drawn as far as it goes then.
    """
    number = 0
    blocks = [setup.stock for setup in problem.setups]
    total = sum(len(cut.keys) for cut in run.sweeps)
    for cut in run.sweeps:
        own = blocks[cut.setup]
        some = spread_rows(cut.points.shape[1], 25)
        points = cut.points[:, some]
        steps = np.arange(len(cut.keys) - 1)
        count = max(1, min(len(steps), round(STRIPS * len(steps) / max(total, 1))))
        kept = [k for k, block in enumerate(blocks) if k >= cut.setup and raster.same_size(block, own)]
        parts = [(part, own.lower, own.upper, kept) for part in np.array_split(steps, count)]
        smaller = (k for k in range(cut.setup + 1, len(blocks)) if k not in kept)
        parts += [
            (steps, blocks[k].lower + TRIMMED_DEPTH_M, blocks[k].upper - TRIMMED_DEPTH_M, [k])
            for k in smaller
        ]
        for part, lower, upper, setups in parts:
            mesh = raster.swept_surface(points[part[0] : part[-1] + 2], lower, upper) if len(part) else None
            if mesh is None:
                continue
            path = f"{BLOCK_PATH}/cut/{number}"
            _surface(film.meshcat, path, mesh, _CUT_COLOUR)
            done = np.arange(len(run.time)) >= cut.keys[part[-1] + 1]
            film.show(path, done & np.isin(run.setup, setups))
            number += 1
