"""Stand-ins for the few names of Rhino 8 and Grasshopper that the components use, to test them without Rhino.

They behave as the documentation of RhinoCommon and Grasshopper says, and do nothing else. They refuse access
from any thread except the canvas's, which is the one that imports this file. Standard library only,
Python 3.9.
"""

import enum
import math
import runpy
import sys
import threading
import time
import types
import uuid
from pathlib import Path

CANVAS = threading.get_ident()
COMPONENTS = Path(__file__).parents[2] / "integrations" / "grasshopper"


def require_canvas_thread():
    """Raise an error if the caller is not in the thread of the canvas."""
    if threading.get_ident() != CANVAS:
        raise RuntimeError("Rhino was touched by another thread")


class UnitSystem(enum.Enum):
    """Lengths in metres; None is none."""

    Unset = 0
    Millimeters = 1e-3
    Meters = 1.0
    Inches = 0.0254


class Point3d:
    def __init__(self, x, y, z):
        require_canvas_thread()
        self.X, self.Y, self.Z = float(x), float(y), float(z)

    def __iter__(self):
        return iter((self.X, self.Y, self.Z))


class Vector3d(Point3d):
    pass


class Plane:
    def __init__(self, origin, x, y):
        require_canvas_thread()
        self.Origin, self.XAxis, self.YAxis = origin, x, y


class Vertices:
    def __init__(self):
        self.points = []

    def Add(self, x, y, z):
        require_canvas_thread()
        self.points.append(Point3d(x, y, z))

    def ToPoint3dArray(self):
        require_canvas_thread()
        return tuple(self.points)


class Faces:
    def __init__(self):
        self.rows = []

    def AddFace(self, a, b, c):
        require_canvas_thread()
        self.rows.append((a, b, c))

    def ToIntArray(self, as_triangles):
        require_canvas_thread()
        assert as_triangles is True
        return tuple(item for row in self.rows for item in row)


class Mesh:
    def __init__(self):
        require_canvas_thread()
        self.Vertices, self.Faces = Vertices(), Faces()
        self.Normals = types.SimpleNamespace(ComputeNormals=require_canvas_thread)


class Polyline(list):
    pass


class PolylineCurve:
    def __init__(self, points):
        self.points = points

    def ToPolyline(self):
        require_canvas_thread()
        return Polyline(self.points)


class ArcCurve:
    """A quarter of a circle about the z axis, approximated by a polyline within a tolerance."""

    def __init__(self, radius, z):
        self.radius, self.z = radius, z

    def ToPolyline(self, tolerance, angle, min_length, max_length):
        require_canvas_thread()
        assert (angle, min_length, max_length) == (0.0, 0.0, 0.0)
        pieces = math.ceil(math.pi / 4 / math.acos(1 - tolerance / self.radius))
        turns = [math.pi / 2 * k / pieces for k in range(pieces + 1)]
        return PolylineCurve(
            [Point3d(self.radius * math.cos(t), self.radius * math.sin(t), self.z) for t in turns]
        )


class TreePath:
    def __init__(self, *branch):
        self.branch = branch


class DataTree:
    """Values by branch."""

    def __class_getitem__(cls, kind):
        assert kind is object
        return cls

    def __init__(self):
        require_canvas_thread()
        self.branches = {}

    def Add(self, value, path):
        require_canvas_thread()
        self.branches.setdefault(path.branch, []).append(value)


class ScheduleDelegate:
    def __init__(self, call):
        self.call = call


class Document:
    """Records the components that are to be solved again."""

    def __init__(self):
        self.scheduled = []

    def ScheduleSolution(self, milliseconds, delegate):
        require_canvas_thread()
        assert isinstance(milliseconds, int)
        assert isinstance(delegate, ScheduleDelegate)
        self.scheduled.append((milliseconds, delegate))


class Component:
    """A script component with its file. ``solve`` does what the canvas does."""

    def __init__(self, name, document):
        self.file, self.document = COMPONENTS / f"{name}.py", document
        self.InstanceGuid, self.RunCount = uuid.uuid4(), 1
        self.Message, self.told, self.expired = "", [], False
        self.longest_s = 0.0

    def OnPingDocument(self):
        require_canvas_thread()
        return self.document

    def ExpireSolution(self, recompute):
        require_canvas_thread()
        assert recompute is False, "only from the callback of a scheduled solution"
        self.expired = True

    def AddRuntimeMessage(self, level, text):
        require_canvas_thread()
        self.told.append((level, text))

    def solve(self, **inputs):
        """Return the script's outputs by name."""
        self.told, self.expired = [], False
        began = time.perf_counter()
        result = runpy.run_path(
            str(self.file), {"ghenv": types.SimpleNamespace(Component=self), **inputs}, "__main__"
        )
        self.longest_s = max(self.longest_s, time.perf_counter() - began)
        return result

    def settle(self, timeout_s=120.0, **inputs):
        """Return the outputs when the document schedules no further solution."""
        until = time.monotonic() + timeout_s
        while True:
            self.document.scheduled.clear()
            result = self.solve(**inputs)
            if not self.document.scheduled:
                return result
            if time.monotonic() > until:
                raise TimeoutError(self.Message)
            ((milliseconds, delegate),) = self.document.scheduled
            time.sleep(milliseconds / 1e3)
            delegate.call(self.document)
            assert self.expired


def install(unit=UnitSystem.Millimeters):
    """Put the modules in place; the document's unit can be set by the namespace that comes back."""
    active = types.SimpleNamespace(ModelUnitSystem=unit)
    kernel = types.SimpleNamespace(
        GH_Document=types.SimpleNamespace(GH_ScheduleDelegate=ScheduleDelegate),
        GH_RuntimeMessageLevel=types.SimpleNamespace(Error="Error", Warning="Warning", Remark="Remark"),
        Data=types.SimpleNamespace(GH_Path=TreePath),
    )
    rhino, grasshopper, context = (types.ModuleType(n) for n in ("Rhino", "Grasshopper", "scriptcontext"))
    rhino.RhinoDoc = types.SimpleNamespace(ActiveDoc=active)
    rhino.UnitSystem = UnitSystem
    rhino.RhinoMath = types.SimpleNamespace(UnitScale=lambda a, b: a.value / b.value)
    rhino.Geometry = types.SimpleNamespace(Point3d=Point3d, Vector3d=Vector3d, Plane=Plane, Mesh=Mesh)
    grasshopper.Kernel, grasshopper.DataTree = kernel, DataTree
    context.sticky = {}
    for item in (rhino, grasshopper, context):
        sys.modules[item.__name__] = item
    for folder in (COMPONENTS, COMPONENTS.parents[1] / "client"):
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))
    return active
