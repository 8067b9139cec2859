"""What Tandem's script components for Grasshopper (Rhino 8, Python 3) do.

Whatever asks the service runs in a thread of its own, which touches nothing of Rhino; what it found is kept
in ``scriptcontext.sticky`` by component. A solution only looks there, so that the canvas never waits, and the
document is asked to solve the component again while its thread is at work. Lengths go out in mm and come
back in the document's unit.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Final

import Grasshopper
import Rhino
import scriptcontext
import tandem_client

POLL_MS: Final = 400
"""After so long a component is solved again while its thread is at work."""
CURVE_TOL_MM: Final = 0.002
"""How far polylines may be off the curves that they stand for."""
NO_UNIT: Final = ("None", "Unset", "CustomUnits")
"""Units of documents by which nothing can be measured."""
LEVELS: Final = {"error": "Error", "warning": "Warning"}
"""How Grasshopper calls the severities of issues; it calls others remarks."""


class Task:
    """Work in a thread of its own. ``value`` is what it gave, ``issues`` why it did not; ``left``: nobody
    waits for it any more."""

    def __init__(self, key: Any, work: Callable[[Task], Any]) -> None:
        self.key, self.stage, self.fraction = key, "", 0.0
        self.job, self.value, self.issues = "", None, ()
        self.done = self.left = self.cancelled = False
        self.shown: Any = None  # what was made of the value for Grasshopper
        threading.Thread(target=self._run, args=(work,), daemon=True).start()

    def _run(self, work: Callable[[Task], Any]) -> None:
        try:
            self.value = work(self)
        except tandem_client.TandemError as error:
            self.issues = error.issues
        except Exception as error:  # a thread has nobody else to tell
            self.issues = (tandem_client.Issue("desk", f"{type(error).__name__}: {error}"),)
        finally:
            self.done = True


class _LeftError(Exception):
    """Nobody waits for what a thread does."""


class Pressed:
    """A component that works when a button is pressed: what the buttons were, the last task, or why there is
    none."""

    def __init__(self) -> None:
        self.was: tuple[bool, ...] = ()
        self.task: Task | None = None
        self.issues: tuple[Any, ...] = ()


def connect(ghenv: Any, url: str | None, token: str | None = None) -> tuple[Any, str]:
    """A client of the service at ``url``, and its version. Without ``token`` the environment's
    ``TANDEM_TOKEN`` is taken."""
    asked = (url or "http://127.0.0.1:8000", token or os.environ.get("TANDEM_TOKEN"))
    clients = scriptcontext.sticky.setdefault("tandem clients", {})
    try:
        if asked not in clients:
            clients[asked] = tandem_client.Client(*asked)
    except tandem_client.TandemError as error:
        _tell(ghenv, error.issues)
        return None, ""
    client = clients[asked]
    task = _task(ghenv, asked, lambda task: client.service())
    _tell(ghenv, task.issues)
    if task.issues:
        _drop(ghenv)  # so that the next solution asks again
    return client, "" if task.value is None else str(task.value["version"])


def job(
    ghenv: Any,
    client: Any,
    problem: Any,
    mesh: Any = None,
    curves: Sequence[Any] | None = None,
    files: Sequence[str] | None = None,
    check: bool | None = False,
    run: bool | None = False,
    cancel: bool | None = False,
) -> tuple[str, str, list[str]]:
    """Checks a problem when ``check`` goes to true, plans it when ``run`` does: id of the job, its state,
    issues. ``mesh`` becomes the part's front, ``curves`` in pairs its ruled surfaces. ``cancel`` ends a job
    that was begun here."""

    def prepared() -> tuple[Any, dict[str, Any]]:
        return _with_part(_said(problem), mesh, list(curves or ()), _sent(files))

    def checked(task: Task, said: Any, sent: Mapping[str, Any]) -> dict[str, Any]:
        return {"state": "checked", "issues": [one.data for one in client.check(said, files=sent)]}

    def planned(task: Task, said: Any, sent: Mapping[str, Any]) -> dict[str, Any]:
        task.job = client.submit(said, files=sent)
        if task.cancelled:  # while it was sent
            client.cancel(task.job)
        return _followed(client, task)

    if cancel and client is not None:
        _cancel(ghenv, client.cancel)
    return _buttons(ghenv, client, problem, prepared, ((check, checked), (run, planned)))


def divide(
    ghenv: Any,
    client: Any,
    element: Any,
    mesh: Any = None,
    files: Sequence[str] | None = None,
    run: bool | None = False,
    cancel: bool | None = False,
) -> tuple[str, str, list[str]]:
    """Divides a building element when ``run`` goes to true: its id, state, issues. ``mesh`` becomes its
    surface. ``cancel`` ends a division that was begun here."""

    def prepared() -> tuple[Any, dict[str, Any]]:
        said, sent = _said(element), _sent(files)
        if mesh is not None and isinstance(said, dict):
            said["surface"] = {"mesh": _mesh(mesh)}
        elif mesh is not None:
            sent["mesh.obj"] = _mesh(mesh)["file"]
        return said, sent

    def divided(task: Task, said: Any, sent: Mapping[str, Any]) -> dict[str, Any]:
        task.job = client.divide(said, files=sent)
        if task.cancelled:  # while it was sent
            client.cancel_element(task.job)
        return _followed(client, task)

    if cancel and client is not None:
        _cancel(ghenv, client.cancel_element)
    return _buttons(ghenv, client, element, prepared, ((run, divided),))


def result(
    ghenv: Any, client: Any, job: str | None, folder: str | None = None, refresh: bool | None = False
) -> tuple[Any, ...]:
    """What became of a job: state, issues, planes at the TCPs, joints [deg], their names, times [s], names of
    targets, planes of the block, the simulated part, programs in ``folder``, links to report and replay.
    ``refresh`` asks anew: a job that was tried again, links that are over.

    Trees have the branches {operation; arm}, joints {operation; arm; joint}, times, targets and blocks
    {operation}.
    """
    if client is None or not job:
        ghenv.Component.Message = "waits for a client and a job"
        return ("", [], *[None] * 10)
    _refreshed(ghenv, refresh)
    task = _task(ghenv, ("result", client, job, folder), lambda task: _fetched(client, task, job, folder))
    if task.value is None:
        if task.issues:
            _drop(ghenv)
        _tell(ghenv, task.issues)
        return (task.stage, _lines(task.issues), *[None] * 10)
    found = task.value
    issues = _issues(found["job"])
    _tell(ghenv, issues)
    ghenv.Component.Message = found["job"]["state"]
    scale, unmeasured = _scale_or_why()
    if scale is None:
        _tell(ghenv, unmeasured)
        return (found["job"]["state"], _lines((*issues, *unmeasured)), *[None] * 10)
    if task.shown is None or task.shown[0] != scale:
        task.shown = scale, _shown(found, scale)
    links = (found["programs"], found["report"], found["replay"])
    return (found["job"]["state"], _lines(issues), *task.shown[1], *links)


def panels(ghenv: Any, client: Any, element: str | None, refresh: bool | None = False) -> tuple[Any, ...]:
    """Panels of an element: their ids, meshes, orders, states, ids of their jobs. ``refresh`` asks for
    their states anew."""
    if client is None or not element:
        ghenv.Component.Message = "waits for a client and an element"
        return [], [], [], [], []
    _refreshed(ghenv, refresh)

    def fetched(task: Task) -> dict[str, Any]:
        task.job = element
        _followed(client, task)
        return {"element": client.element(element), "meshes": client.meshes(element, "element.obj")}

    task = _task(ghenv, ("panels", client, element), fetched)
    _tell(ghenv, task.issues)
    if task.value is None:
        if task.issues:
            _drop(ghenv)
        return [], [], [], [], []
    found = task.value["element"]
    scale, unmeasured = _scale_or_why()
    if scale is None:
        _tell(ghenv, unmeasured)
        return [], [], [], [], []
    if task.shown is None or task.shown[0] != scale:
        meshes = {name: _rhino_mesh(one, scale) for name, one in task.value["meshes"].items()}
        task.shown = scale, meshes
    rows = found.get("panels", [])
    ghenv.Component.Message = f"{len(rows)} panels"
    columns = [[one.get(key) for one in rows] for key in ("id", "order", "state", "job")]
    return columns[0], [task.shown[1].get(name) for name in columns[0]], *columns[1:]


def _refreshed(ghenv: Any, refresh: bool | None) -> None:
    """Forget what a component has fetched when ``refresh`` goes to true."""
    state = scriptcontext.sticky.setdefault(f"{_name(ghenv)} button", Pressed())
    if (bool(refresh),) != state.was and refresh:
        _drop(ghenv)
    state.was = (bool(refresh),)


def _name(ghenv: Any) -> str:
    """Where a component keeps what it has; one that runs for several items keeps each."""
    return f"tandem {ghenv.Component.InstanceGuid} {ghenv.Component.RunCount}"


def _drop(ghenv: Any) -> None:
    """Forget a component's task."""
    held = scriptcontext.sticky.pop(_name(ghenv), None)
    if held is not None:
        held.left = True


def _task(ghenv: Any, key: Any, work: Callable[[Task], Any]) -> Task:
    """The task of a component for what is asked, begun where something else was asked before."""
    held: Task | None = scriptcontext.sticky.get(_name(ghenv))
    if held is None or held.key != key:
        _drop(ghenv)
        held = scriptcontext.sticky[_name(ghenv)] = Task(key, work)
    _watch(ghenv, held)
    return held


def _watch(ghenv: Any, task: Task) -> None:
    """Show how far a task is; while it is at work the component is solved again."""
    component = ghenv.Component
    component.Message = f"{task.stage} {task.fraction:.0%}" if task.stage else "..."
    if task.done:
        component.Message = task.stage
        return
    document = component.OnPingDocument()
    if document is not None:

        def expire(_: Any) -> None:
            component.ExpireSolution(False)

        document.ScheduleSolution(POLL_MS, Grasshopper.Kernel.GH_Document.GH_ScheduleDelegate(expire))


def _buttons(
    ghenv: Any,
    client: Any,
    what: Any,
    prepared: Callable[[], tuple[Any, dict[str, Any]]],
    buttons: Iterable[tuple[bool | None, Callable[..., Any]]],
) -> tuple[str, str, list[str]]:
    """Begin the work of a button that was pressed; id, state and issues of what was begun last.

    What is sent is read of Rhino here, in its own thread, once for each press. A switch that is on when the
    component is solved for the first time, as a document opens, is no press.
    """
    state = scriptcontext.sticky.setdefault(f"{_name(ghenv)} button", Pressed())
    pressed = tuple(bool(button) for button, _ in buttons)
    before, state.was = state.was or pressed, pressed
    ready = client is not None and what is not None
    for now, then, (_, work) in zip(pressed, before, buttons):
        if now and not then and ready:
            if state.task is not None:
                state.task.left = True
            state.task, state.issues = None, ()
            try:
                sent = prepared()
                state.task = Task(None, lambda task, work=work, sent=sent: work(task, *sent))
            except (ValueError, OSError) as error:
                state.issues = (tandem_client.Issue("desk", str(error)),)
    task = state.task
    if task is None:
        ghenv.Component.Message = "press the button" if ready else "waits for a client and a problem"
        _tell(ghenv, state.issues)
        return "", "", _lines(state.issues)
    _watch(ghenv, task)
    found = task.issues
    ended = ""
    if task.value is not None:
        ended = ghenv.Component.Message = task.value["state"]
        found = _issues(task.value)
    _tell(ghenv, found)
    return task.job, ended or task.stage, _lines(found)


def _cancel(ghenv: Any, cancel: Callable[[str], Any]) -> None:
    """Cancel the job that a component has begun, once, by what cancels one of its id."""
    state = scriptcontext.sticky.get(f"{_name(ghenv)} button")
    task = None if state is None else state.task
    if task is None or task.done or task.cancelled:
        return
    task.cancelled = True
    if not task.job:
        return  # who sends it cancels it then

    def ask() -> None:
        try:
            cancel(task.job)
        except tandem_client.TandemError as error:
            task.issues = error.issues

    threading.Thread(target=ask, daemon=True).start()


def _followed(client: Any, task: Task) -> dict[str, Any]:
    """A job when it has ended; how far it is meanwhile is told to the task."""

    def progress(stage: str, fraction: float) -> None:
        if task.left:
            raise _LeftError
        task.stage, task.fraction = stage, fraction

    found: dict[str, Any] = client.wait(task.job, progress)
    return found


def _fetched(client: Any, task: Task, job: str, folder: str | None) -> dict[str, Any]:
    """All of a job that has ended."""
    task.job = job
    found: dict[str, Any] = {"job": _followed(client, task), "motion": None, "part": {}, "programs": []}
    state = found["job"]["state"]
    if state in tandem_client.PLANNED:
        found["motion"] = client.motion(job)
        found["part"] = _there(lambda: client.meshes(job)) or {}
    if state == "verified" and folder:
        found["programs"] = save(client.programs(job), Path(folder) / f"{found['job']['name']}-{job[:8]}")
    found["report"] = _there(lambda: client.report_url(job))
    found["replay"] = _there(lambda: client.replay_url(job))
    return found


def _there(ask: Callable[[], Any]) -> Any:
    """What a job has, or None: what follows poses leaves no part, what was cancelled has no report."""
    try:
        return ask()
    except tandem_client.TandemError as error:
        if all(issue.code == "service.unknown_file" for issue in error.issues):
            return None
        raise


def save(programs: Mapping[str, str], folder: Path) -> list[str]:
    """Write programs into a folder; their paths. Raises ``ValueError`` for a name that leads out of it."""
    paths = []
    for name, text in programs.items():
        parts = PurePosixPath(name).parts
        if not parts or any(one in ("..", "/") or set(one) & set('\\:*?"<>|') for one in parts):
            raise ValueError(f"the service names a program {name!r}, which is no name of a file here")
        path = folder.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_name(path.name + ".part")
        beside.write_bytes(text.encode("utf-8"))
        os.replace(beside, path)  # noqa: PTH105
        paths.append(str(path))
    return paths


def _said(problem: Any) -> Any:
    """A problem as a dict of one's own, out of a dict or JSON; else the path of a file. Raises ``ValueError``
    for other text."""
    if isinstance(problem, Mapping):
        return dict(problem)
    text = str(problem).strip()
    if text.startswith("{"):
        try:
            found = json.loads(text)
        except ValueError as error:
            raise ValueError(f"problem: is no JSON ({error}); correct it, or give a dict or a path") from None
        return dict(found)
    if "\n" in text or not Path(text).is_file():
        raise ValueError(f"problem: {text[:80]!r} is no file; give the path of one, a dict, or JSON")
    return Path(text)


def _sent(files: Sequence[str] | None) -> dict[str, Any]:
    """Files by the names that a problem has for them."""
    sent: dict[str, Any] = {}
    for path in map(Path, files or ()):
        if sent.setdefault(path.name, path) != path:
            raise ValueError(f"files: two are called {path.name}, {sent[path.name]} and {path}; rename one")
    return sent


def _with_part(
    said: Any, mesh: Any, curves: Sequence[Any], sent: dict[str, Any]
) -> tuple[Any, dict[str, Any]]:
    """A problem with a mesh as its front and pairs of curves as its ruled surfaces, and the files that go
    along. A file's part is its own: it finds the mesh as ``mesh.obj``, in mm."""
    if not isinstance(said, dict):
        if curves:
            raise ValueError("curves go with a problem that is a dict or JSON; a file has its own guides")
        if mesh is not None:
            sent["mesh.obj"] = _mesh(mesh)["file"]
        return said, sent
    part = dict(said.get("part") or {})
    if mesh is not None:
        part["front"] = {**(part.get("front") or {}), "mesh": _mesh(mesh)}
    if len(curves) % 2:
        raise ValueError(f"curves: got {len(curves)}; give two for each surface, its start and its end")
    if curves:
        known = list(part.get("ruled") or [])
        known += [{"name": f"surface_{k + 1}"} for k in range(len(known), len(curves) // 2)]
        part["ruled"] = [
            {**own, "start": _guide(start), "end": _guide(end)}
            for own, start, end in zip(known, curves[::2], curves[1::2])
        ]
    return ({**said, "part": part} if part else said), sent


def _scale() -> float:
    """Length [mm] of the document's unit. Raises ``ValueError`` for a document without one."""
    unit = Rhino.RhinoDoc.ActiveDoc.ModelUnitSystem
    if str(unit).rpartition(".")[2] in NO_UNIT:
        raise ValueError(f"the document's unit is {unit}; set one, such as millimetres, by _Units")
    return float(Rhino.RhinoMath.UnitScale(unit, Rhino.UnitSystem.Millimeters))


def _scale_or_why() -> tuple[float | None, tuple[Any, ...]]:
    """As :func:`_scale`, or None and an issue."""
    try:
        return _scale(), ()
    except ValueError as error:
        return None, (tandem_client.Issue("desk", str(error)),)


def _mesh(mesh: Any) -> dict[str, Any]:
    """A mesh of Rhino as a problem has it."""
    scale = _scale()
    points = [(scale * one.X, scale * one.Y, scale * one.Z) for one in mesh.Vertices.ToPoint3dArray()]
    corners = [int(one) for one in mesh.Faces.ToIntArray(True)]
    return {"file": (points, list(zip(corners[::3], corners[1::3], corners[2::3]))), "unit": "mm"}


def _guide(curve: Any) -> dict[str, Any]:
    """A curve of Rhino as a guide."""
    scale = _scale()
    found = curve.ToPolyline(CURVE_TOL_MM / scale, 0.0, 0.0, 0.0)
    if found is None:
        raise ValueError("a curve cannot be made a polyline; see that it is valid by _What")
    points = found.ToPolyline()
    return {"polyline_mm": [[scale * one.X, scale * one.Y, scale * one.Z] for one in points]}


def _shown(found: Mapping[str, Any], scale: float) -> tuple[Any, ...]:
    """Trees of planes, joints, names, times, targets and blocks, and the part's meshes."""
    trees = [Grasshopper.DataTree[object]() for _ in range(6)]
    planes, joints, names, times, targets, blocks = trees
    motion = found["motion"] or {"operations": [], "arms": {}}
    arms = list(motion["arms"])
    for i, own in enumerate(motion["operations"]):
        for name, way in own["arms"].items():
            j = arms.index(name)
            _add(planes, (_plane(one, scale) for one in way["tcp"]), i, j)
            _add(names, motion["arms"][name]["joints"], i, j)
            for k, column in enumerate(zip(*way["joints_deg"])):
                _add(joints, column, i, j, k)
        _add(times, own["time_s"], i)
        _add(targets, own["names"], i)
        if "plane" in own["block"]:
            _add(blocks, [_plane(own["block"]["plane"], scale)], i)
    return (*trees, [_rhino_mesh(one, scale) for one in found["part"].values()])


def _add(tree: Any, values: Iterable[Any], *branch: int) -> None:
    path = Grasshopper.Kernel.Data.GH_Path(*branch)
    for value in values:
        tree.Add(value, path)


def _plane(nine: Sequence[float], scale: float) -> Any:
    x, y, z = (one / scale for one in nine[:3])
    geometry = Rhino.Geometry
    return geometry.Plane(
        geometry.Point3d(x, y, z), geometry.Vector3d(*nine[3:6]), geometry.Vector3d(*nine[6:9])
    )


def _rhino_mesh(found: tuple[Any, Any], scale: float) -> Any:
    points, faces = found
    mesh = Rhino.Geometry.Mesh()
    for x, y, z in points:
        mesh.Vertices.Add(x / scale, y / scale, z / scale)
    for face in faces:
        for b, c in zip(face[1:], face[2:]):  # Rhino's faces have four corners at most
            mesh.Faces.AddFace(face[0], b, c)
    mesh.Normals.ComputeNormals()
    return mesh


def _issues(job: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(tandem_client.Issue.from_dict(one) for one in job["issues"])


def _lines(issues: Iterable[Any]) -> list[str]:
    return [str(one) for one in issues]


def _tell(ghenv: Any, issues: Iterable[Any]) -> None:
    """Show issues at the component."""
    levels = Grasshopper.Kernel.GH_RuntimeMessageLevel
    for one in issues:
        level = getattr(levels, LEVELS.get(one.severity, "Remark"))
        ghenv.Component.AddRuntimeMessage(level, str(one))
