"""Functions of Tandem's script components for Grasshopper (Rhino 8, Python 3).

Requests to the service run in threads that do not touch Rhino. Their results are kept in
``scriptcontext.sticky`` by component. A solution only reads them, so that the canvas never blocks, and the
document solves the component again while its thread is running. Lengths are sent in mm and returned in the
unit of the document.
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
"""Time [ms] after which a component with a running thread is solved again."""
CURVE_TOL_MM: Final = 0.002
"""Maximum deviation [mm] of polylines from the curves that they approximate."""
NO_UNIT: Final = ("None", "Unset", "CustomUnits")
"""Document units without a length."""
LEVELS: Final = {"error": "Error", "warning": "Warning"}
"""Grasshopper's names of severities. Other severities are remarks."""


class Task:
    """Work in a thread of its own.

    Attributes:
        value: Result.
        issues: Why there is no result.
        left: Nobody waits for it any more.
    """

    def __init__(self, key: Any, work: Callable[[Task], Any]) -> None:
        self.key, self.stage, self.fraction = key, "", 0.0
        self.job, self.value, self.issues = "", None, ()
        self.done = self.left = self.cancelled = False
        self.shown: Any = None  # the value as Grasshopper data
        threading.Thread(target=self._run, args=(work,), daemon=True).start()

    def _run(self, work: Callable[[Task], Any]) -> None:
        try:
            self.value = work(self)
        except tandem_client.TandemError as error:
            self.issues = error.issues
        except Exception as error:  # otherwise lost with the thread
            self.issues = (tandem_client.Issue("desk", f"{type(error).__name__}: {error}"),)
        finally:
            self.done = True


class _AbandonedError(Exception):
    """Nobody waits for the result of a thread."""


class Pressed:
    """State of a component with buttons: their last values, the last task, or why there is none."""

    def __init__(self) -> None:
        self.was: tuple[bool, ...] = ()
        self.task: Task | None = None
        self.issues: tuple[Any, ...] = ()


def connect(ghenv: Any, url: str | None, token: str | None = None) -> tuple[Any, str]:
    """Return a client of the service, and its version.

    Args:
        ghenv: Environment of the component.
        url: Address of the service, by default this machine.
        token: API token, by default the environment variable ``TANDEM_TOKEN``.
    """
    key = (url or "http://127.0.0.1:8000", token or os.environ.get("TANDEM_TOKEN"))
    clients = scriptcontext.sticky.setdefault("tandem clients", {})
    try:
        if key not in clients:
            clients[key] = tandem_client.Client(*key)
    except tandem_client.TandemError as error:
        _show_issues(ghenv, error.issues)
        return None, ""
    client = clients[key]
    task = _task(ghenv, key, lambda task: client.service())
    _show_issues(ghenv, task.issues)
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
    """Check a problem when ``check`` becomes true, plan it when ``run`` does.

    Args:
        ghenv: Environment of the component.
        client: Client.
        problem: Problem.
        mesh: Mesh that becomes the front of the part.
        curves: Pairs of curves that become its ruled surfaces.
        files: Paths of files that the problem uses.
        check: Check button.
        run: Plan button.
        cancel: Cancel the job that was started here.

    Returns:
        Id of the job, its state, issues.
    """

    def prepared() -> tuple[Any, dict[str, Any]]:
        return _with_part(_parse_problem(problem), mesh, list(curves or ()), _files_by_name(files))

    def checked(task: Task, content: Any, sent: Mapping[str, Any]) -> dict[str, Any]:
        return {"state": "checked", "issues": [issue.data for issue in client.check(content, files=sent)]}

    def planned(task: Task, content: Any, sent: Mapping[str, Any]) -> dict[str, Any]:
        task.job = client.submit(content, files=sent)
        if task.cancelled:  # while it was sent
            client.cancel(task.job)
        return _wait_for_job(client, task)

    if cancel and client is not None:
        _cancel(ghenv, client.cancel)
    return _handle_buttons(ghenv, client, problem, prepared, ((check, checked), (run, planned)))


def divide(
    ghenv: Any,
    client: Any,
    element: Any,
    mesh: Any = None,
    files: Sequence[str] | None = None,
    run: bool | None = False,
    cancel: bool | None = False,
) -> tuple[str, str, list[str]]:
    """Divide a building element when ``run`` becomes true.

    Args:
        ghenv: Environment of the component.
        client: Client.
        element: Element.
        mesh: Mesh that becomes its surface.
        files: Paths of files that the element uses.
        run: Divide button.
        cancel: Cancel the division that was started here.

    Returns:
        Id of the element, its state, issues.
    """

    def prepared() -> tuple[Any, dict[str, Any]]:
        content, uploads = _parse_problem(element), _files_by_name(files)
        if mesh is not None and isinstance(content, dict):
            content["surface"] = {"mesh": _problem_mesh(mesh)}
        elif mesh is not None:
            uploads["mesh.obj"] = _problem_mesh(mesh)["file"]
        return content, uploads

    def divided(task: Task, content: Any, sent: Mapping[str, Any]) -> dict[str, Any]:
        task.job = client.divide(content, files=sent)
        if task.cancelled:  # while it was sent
            client.cancel_element(task.job)
        return _wait_for_job(client, task)

    if cancel and client is not None:
        _cancel(ghenv, client.cancel_element)
    return _handle_buttons(ghenv, client, element, prepared, ((run, divided),))


def result(
    ghenv: Any, client: Any, job: str | None, folder: str | None = None, refresh: bool | None = False
) -> tuple[Any, ...]:
    """Return the results of a job.

    Trees have the branches {operation; arm}, joints {operation; arm; joint}, times, targets and blocks
    {operation}.

    Args:
        ghenv: Environment of the component.
        client: Client.
        job: Id of the job.
        folder: Folder for programs.
        refresh: Query again, for a job that was retried or links that have expired.

    Returns:
        State, issues, planes at the TCPs, joints [deg], their names, times [s], names of targets, planes of
        the block, the simulated part, programs in ``folder``, links to report and replay.
    """
    if client is None or not job:
        ghenv.Component.Message = "connect a client and a job"
        return ("", [], *[None] * 10)
    _apply_refresh(ghenv, refresh)
    task = _task(
        ghenv, ("result", client, job, folder), lambda task: _fetch_results(client, task, job, folder)
    )
    if task.value is None:
        if task.issues:
            _drop(ghenv)
        _show_issues(ghenv, task.issues)
        return (task.stage, _issue_lines(task.issues), *[None] * 10)
    results = task.value
    issues = _job_issues(results["job"])
    _show_issues(ghenv, issues)
    ghenv.Component.Message = results["job"]["state"]
    scale, unmeasured = _unit_or_issues()
    if scale is None:
        _show_issues(ghenv, unmeasured)
        return (results["job"]["state"], _issue_lines((*issues, *unmeasured)), *[None] * 10)
    if task.shown is None or task.shown[0] != scale:
        task.shown = scale, _result_values(results, scale)
    links = (results["programs"], results["report"], results["replay"])
    return (results["job"]["state"], _issue_lines(issues), *task.shown[1], *links)


def panels(ghenv: Any, client: Any, element: str | None, refresh: bool | None = False) -> tuple[Any, ...]:
    """Return the panels of an element: ids, meshes, orders, states, ids of their jobs.

    Args:
        ghenv: Environment of the component.
        client: Client.
        element: Id of the element.
        refresh: Query their states again.
    """
    if client is None or not element:
        ghenv.Component.Message = "connect a client and an element"
        return [], [], [], [], []
    _apply_refresh(ghenv, refresh)

    def fetched(task: Task) -> dict[str, Any]:
        task.job = element
        _wait_for_job(client, task)
        return {"element": client.element(element), "meshes": client.meshes(element, "element.obj")}

    task = _task(ghenv, ("panels", client, element), fetched)
    _show_issues(ghenv, task.issues)
    if task.value is None:
        if task.issues:
            _drop(ghenv)
        return [], [], [], [], []
    element_data = task.value["element"]
    scale, unmeasured = _unit_or_issues()
    if scale is None:
        _show_issues(ghenv, unmeasured)
        return [], [], [], [], []
    if task.shown is None or task.shown[0] != scale:
        meshes = {name: _rhino_mesh(row, scale) for name, row in task.value["meshes"].items()}
        task.shown = scale, meshes
    rows = element_data.get("panels", [])
    ghenv.Component.Message = f"{len(rows)} panels"
    columns = [[row.get(key) for row in rows] for key in ("id", "order", "state", "job")]
    return columns[0], [task.shown[1].get(name) for name in columns[0]], *columns[1:]


def _apply_refresh(ghenv: Any, refresh: bool | None) -> None:
    """Drop the results of a component when ``refresh`` becomes true."""
    state = scriptcontext.sticky.setdefault(f"{_storage_key(ghenv)} button", Pressed())
    if (bool(refresh),) != state.was and refresh:
        _drop(ghenv)
    state.was = (bool(refresh),)


def _storage_key(ghenv: Any) -> str:
    """Return the storage key of a component. One that runs for several items has a key for each."""
    return f"tandem {ghenv.Component.InstanceGuid} {ghenv.Component.RunCount}"


def _drop(ghenv: Any) -> None:
    """Drop the task of a component."""
    held = scriptcontext.sticky.pop(_storage_key(ghenv), None)
    if held is not None:
        held.left = True


def _task(ghenv: Any, key: Any, work: Callable[[Task], Any]) -> Task:
    """Return the task of a component for a request. A different request starts a new task."""
    held: Task | None = scriptcontext.sticky.get(_storage_key(ghenv))
    if held is None or held.key != key:
        _drop(ghenv)
        held = scriptcontext.sticky[_storage_key(ghenv)] = Task(key, work)
    _show_progress(ghenv, held)
    return held


def _show_progress(ghenv: Any, task: Task) -> None:
    """Show the progress of a task, and solve the component again while it is running."""
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


def _handle_buttons(
    ghenv: Any,
    client: Any,
    what: Any,
    prepared: Callable[[], tuple[Any, dict[str, Any]]],
    buttons: Iterable[tuple[bool | None, Callable[..., Any]]],
) -> tuple[str, str, list[str]]:
    """Start the work of a button that was pressed. Return id, state and issues of the last started work.

    Input is read from Rhino here, in Rhino's thread, once for each press. A switch that is on when the
    component is solved for the first time, as when a document opens, is not a press.
    """
    state = scriptcontext.sticky.setdefault(f"{_storage_key(ghenv)} button", Pressed())
    pressed = tuple(bool(button) for button, _ in buttons)
    previous, state.was = state.was or pressed, pressed
    ready = client is not None and what is not None
    for is_on, was_on, (_, work) in zip(pressed, previous, buttons):
        if is_on and not was_on and ready:
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
        ghenv.Component.Message = "press the button" if ready else "connect a client and a problem"
        _show_issues(ghenv, state.issues)
        return "", "", _issue_lines(state.issues)
    _show_progress(ghenv, task)
    issues = task.issues
    ended = ""
    if task.value is not None:
        ended = ghenv.Component.Message = task.value["state"]
        issues = _job_issues(task.value)
    _show_issues(ghenv, issues)
    return task.job, ended or task.stage, _issue_lines(issues)


def _cancel(ghenv: Any, cancel: Callable[[str], Any]) -> None:
    """Cancel, once, the job that a component has started."""
    state = scriptcontext.sticky.get(f"{_storage_key(ghenv)} button")
    task = None if state is None else state.task
    if task is None or task.done or task.cancelled:
        return
    task.cancelled = True
    if not task.job:
        return  # the sending thread cancels it

    def ask() -> None:
        try:
            cancel(task.job)
        except tandem_client.TandemError as error:
            task.issues = error.issues

    threading.Thread(target=ask, daemon=True).start()


def _wait_for_job(client: Any, task: Task) -> dict[str, Any]:
    """Return a job when it has ended. Meanwhile the task gets its progress."""

    def progress(stage: str, fraction: float) -> None:
        if task.left:
            raise _AbandonedError
        task.stage, task.fraction = stage, fraction

    finished: dict[str, Any] = client.wait(task.job, progress)
    return finished


def _fetch_results(client: Any, task: Task, job: str, folder: str | None) -> dict[str, Any]:
    """Return all results of a job that has ended."""
    task.job = job
    results: dict[str, Any] = {"job": _wait_for_job(client, task), "motion": None, "part": {}, "programs": []}
    state = results["job"]["state"]
    if state in tandem_client.PLANNED:
        results["motion"] = client.motion(job)
        results["part"] = _result_or_none(lambda: client.meshes(job)) or {}
    if state == "verified" and folder:
        results["programs"] = save(client.programs(job), Path(folder) / f"{results['job']['name']}-{job[:8]}")
    results["report"] = _result_or_none(lambda: client.report_url(job))
    results["replay"] = _result_or_none(lambda: client.replay_url(job))
    return results


def _result_or_none(ask: Callable[[], Any]) -> Any:
    """Return a result of a job, or None: given poses leave no part, and a cancelled job has no report."""
    try:
        return ask()
    except tandem_client.TandemError as error:
        if all(issue.code == "service.unknown_file" for issue in error.issues):
            return None
        raise


def save(programs: Mapping[str, str], folder: Path) -> list[str]:
    """Write programs into a folder.

    Args:
        programs: Programs by name.
        folder: Folder.

    Returns:
        Paths.

    Raises:
        ValueError: A name leads out of the folder.
    """
    paths = []
    for name, text in programs.items():
        parts = PurePosixPath(name).parts
        if not parts or any(part in ("..", "/") or set(part) & set('\\:*?"<>|') for part in parts):
            raise ValueError(f"the service sent a program {name!r}, which is not a valid file name here.")
        path = folder.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(path.name + ".part")
        temporary.write_bytes(text.encode("utf-8"))
        os.replace(temporary, path)  # noqa: PTH105
        paths.append(str(path))
    return paths


def _parse_problem(problem: Any) -> Any:
    """Return a copy of a problem as a dict, from a dict or JSON, else the path of a file.

    Raises:
        ValueError: Any other text.
    """
    if isinstance(problem, Mapping):
        return dict(problem)
    text = str(problem).strip()
    if text.startswith("{"):
        try:
            data = json.loads(text)
        except ValueError as error:
            raise ValueError(f"problem: invalid JSON ({error}). Give valid JSON, a dict or a path.") from None
        return dict(data)
    if "\n" in text or not Path(text).is_file():
        raise ValueError(f"problem: {text[:80]!r} is not a file. Give the path of one, a dict, or JSON.")
    return Path(text)


def _files_by_name(files: Sequence[str] | None) -> dict[str, Any]:
    """Return files by the names that a problem uses."""
    uploads: dict[str, Any] = {}
    for path in map(Path, files or ()):
        if uploads.setdefault(path.name, path) != path:
            raise ValueError(
                f"files: two are named {path.name}: {uploads[path.name]} and {path}. Rename one."
            )
    return uploads


def _with_part(
    content: Any, mesh: Any, curves: Sequence[Any], uploads: dict[str, Any]
) -> tuple[Any, dict[str, Any]]:
    """Add a mesh as front and pairs of curves as ruled surfaces to a problem. Return it with its files.

    The part of a problem file is not changed: it refers to the mesh as ``mesh.obj``, in mm.
    """
    if not isinstance(content, dict):
        if curves:
            raise ValueError("curves require a problem that is a dict or JSON. A file has its own guides.")
        if mesh is not None:
            uploads["mesh.obj"] = _problem_mesh(mesh)["file"]
        return content, uploads
    part = dict(content.get("part") or {})
    if mesh is not None:
        part["front"] = {**(part.get("front") or {}), "mesh": _problem_mesh(mesh)}
    if len(curves) % 2:
        raise ValueError(f"curves: got {len(curves)}. Give two for each surface, its start and its end.")
    if curves:
        surfaces = list(part.get("ruled") or [])
        surfaces += [{"name": f"surface_{k + 1}"} for k in range(len(surfaces), len(curves) // 2)]
        part["ruled"] = [
            {**surface, "start": _problem_guide(start), "end": _problem_guide(end)}
            for surface, start, end in zip(surfaces, curves[::2], curves[1::2])
        ]
    return ({**content, "part": part} if part else content), uploads


def _document_unit_mm() -> float:
    """Return the length [mm] of the document's unit.

    Raises:
        ValueError: The document has no unit.
    """
    unit = Rhino.RhinoDoc.ActiveDoc.ModelUnitSystem
    if str(unit).rpartition(".")[2] in NO_UNIT:
        raise ValueError(f"the document's unit is {unit}. Set one, such as millimetres, by _Units.")
    return float(Rhino.RhinoMath.UnitScale(unit, Rhino.UnitSystem.Millimeters))


def _unit_or_issues() -> tuple[float | None, tuple[Any, ...]]:
    """Return the result of :func:`_document_unit_mm`, or None and an issue."""
    try:
        return _document_unit_mm(), ()
    except ValueError as error:
        return None, (tandem_client.Issue("desk", str(error)),)


def _problem_mesh(mesh: Any) -> dict[str, Any]:
    """Convert a mesh of Rhino to the form of problems."""
    scale = _document_unit_mm()
    points = [(scale * value.X, scale * value.Y, scale * value.Z) for value in mesh.Vertices.ToPoint3dArray()]
    corners = [int(value) for value in mesh.Faces.ToIntArray(True)]
    return {"file": (points, list(zip(corners[::3], corners[1::3], corners[2::3]))), "unit": "mm"}


def _problem_guide(curve: Any) -> dict[str, Any]:
    """Convert a curve of Rhino to a guide."""
    scale = _document_unit_mm()
    polyline_curve = curve.ToPolyline(CURVE_TOL_MM / scale, 0.0, 0.0, 0.0)
    if polyline_curve is None:
        raise ValueError("a curve cannot be converted to a polyline. Check by _What that it is valid.")
    points = polyline_curve.ToPolyline()
    return {"polyline_mm": [[scale * point.X, scale * point.Y, scale * point.Z] for point in points]}


def _result_values(results: Mapping[str, Any], scale: float) -> tuple[Any, ...]:
    """Return trees of planes, joints, names, times, targets and blocks, and the meshes of the part."""
    trees = [Grasshopper.DataTree[object]() for _ in range(6)]
    planes, joints, names, times, targets, blocks = trees
    motion = results["motion"] or {"operations": [], "arms": {}}
    arms = list(motion["arms"])
    for i, operation in enumerate(motion["operations"]):
        for name, path in operation["arms"].items():
            j = arms.index(name)
            _add_branch(planes, (_plane(item, scale) for item in path["tcp"]), i, j)
            _add_branch(names, motion["arms"][name]["joints"], i, j)
            for k, column in enumerate(zip(*path["joints_deg"])):
                _add_branch(joints, column, i, j, k)
        _add_branch(times, operation["time_s"], i)
        _add_branch(targets, operation["names"], i)
        if "plane" in operation["block"]:
            _add_branch(blocks, [_plane(operation["block"]["plane"], scale)], i)
    return (*trees, [_rhino_mesh(item, scale) for item in results["part"].values()])


def _add_branch(tree: Any, values: Iterable[Any], *branch: int) -> None:
    path = Grasshopper.Kernel.Data.GH_Path(*branch)
    for value in values:
        tree.Add(value, path)


def _plane(values: Sequence[float], scale: float) -> Any:
    x, y, z = (value / scale for value in values[:3])
    geometry = Rhino.Geometry
    return geometry.Plane(
        geometry.Point3d(x, y, z), geometry.Vector3d(*values[3:6]), geometry.Vector3d(*values[6:9])
    )


def _rhino_mesh(mesh_data: tuple[Any, Any], scale: float) -> Any:
    points, faces = mesh_data
    mesh = Rhino.Geometry.Mesh()
    for x, y, z in points:
        mesh.Vertices.Add(x / scale, y / scale, z / scale)
    for face in faces:
        for b, c in zip(face[1:], face[2:]):  # Rhino's faces have at most four corners
            mesh.Faces.AddFace(face[0], b, c)
    mesh.Normals.ComputeNormals()
    return mesh


def _job_issues(job: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(tandem_client.Issue.from_dict(data) for data in job["issues"])


def _issue_lines(issues: Iterable[Any]) -> list[str]:
    return [str(issue) for issue in issues]


def _show_issues(ghenv: Any, issues: Iterable[Any]) -> None:
    """Show issues at the component."""
    levels = Grasshopper.Kernel.GH_RuntimeMessageLevel
    for issue in issues:
        level = getattr(levels, LEVELS.get(issue.severity, "Remark"))
        ghenv.Component.AddRuntimeMessage(level, str(issue))
