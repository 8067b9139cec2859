"""Problems said in Python: sections with the words of a problem file, and arrays and meshes as values.

>>> from planner import spec
>>> base = spec.Pose(xyz_mm=[0, 0, 200])
>>> arm = spec.Arm(name="robot", robot="irb140", base=base, tool=spec.Bow(span_mm=400))
>>> arm["base"]
{'xyz_mm': [0, 0, 200]}

Each section takes the keys that ``docs/problem_file.md`` lists for it, with the same units and ranges, and
is checked when it is made; what goes across sections is checked by :func:`planner.build`, by the reader
that problem files go through. A value may be a plain one, a numpy array, another section, or a mapping with
the keys of one. A ``file`` that has a ``unit`` may be a mesh: a ``trimesh.Trimesh``, a pair of arrays
(vertices (V, 3), faces (F, 3)), or a grid of points (N, M, 3), which faces the way of (along N) x (along M).
Names of files start at the working directory. Sections do not change: :meth:`Section.replace` and
:meth:`Section.changed` give others.
"""

import copy
import inspect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import BaseModel

from planner.catalogue.robots import bundled, data_dir
from planner.files import is_file
from planner.geometry.arrays import to_rpy
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.processes import registry
from planner.processes.forming.plan import operation as forming
from planner.processes.hotwire.plan import operation as hotwire
from planner.processes.milling.plan import operation as milling
from planner.processes.poses.plan import job as pose_table
from planner.processes.trim.plan import operation as trim
from planner.reading import (
    axes,
    cell,
    controller,
    loads,
    materials,
    part,
    part_ruled,
    part_surfaces,
    rails,
    rhino,
    robot_file,
    sheet,
    step,
    stock,
    strict_yaml,
    values,
)
from planner.reading import problem as problem_file
from planner.reading.strict_yaml import Document


class Section(Mapping[str, Any]):
    """A section of a problem file: a mapping of its keys to plain values, as YAML would have them.

    Raises ``TandemError``: ``problem.field`` and ``problem.not_finite``, with the name of the section.
    """

    model: ClassVar[type[BaseModel] | None] = None
    fixed: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, model: type[BaseModel] | None = None, **fixed: Any) -> None:
        super().__init_subclass__()
        if model is None:
            return
        cls.model, cls.fixed = model, fixed
        cls.__doc__ = cls.__doc__ or inspect.getdoc(model)
        own = [p for p in inspect.signature(model).parameters.values() if p.name not in fixed]
        cls.__signature__ = inspect.Signature(own)  # type: ignore[attr-defined]

    def __init__(self, **words: Any) -> None:
        self._words: dict[str, Any] = {**self.fixed, **values.plain(dict(words), type(self).__name__)}
        self._check()

    def _check(self) -> None:
        if self.model is not None:
            _, faults = problem_file.validate(self.model, self._words, _document(self._words), ())
            _refuse(faults, type(self).__name__)

    def __setattr__(self, name: str, value: Any) -> None:
        if name != "_words":
            what = f"a {type(self).__name__} does not change; replace({name}=...) gives another"
            raise AttributeError(what)
        super().__setattr__(name, value)

    def __getitem__(self, key: str) -> Any:
        return copy.deepcopy(self._words[key])

    def __iter__(self) -> Iterator[str]:
        return iter(self._words)

    def __len__(self) -> int:
        return len(self._words)

    def __repr__(self) -> str:
        words = ", ".join(f"{k}={v!r}" for k, v in self._words.items() if k not in self.fixed)
        return f"{type(self).__name__}({words})"

    def replace(self, **words: Any) -> Self:
        """The same section with some of its words said otherwise; raises as the section itself."""
        return type(self)(**{**{k: v for k, v in self._words.items() if k not in self.fixed}, **words})

    def changed(self, path: str, value: Any) -> Self:
        """The same section with the field at ``path`` changed, such as ``stock.size_mm`` or
        ``operations.0.feed_mm_s``; entries of lists go by number or by their ``name``. Raises as the section
        itself, and ``problem.field`` for a path that it does not have."""
        words = copy.deepcopy({k: v for k, v in self._words.items() if k not in self.fixed})
        try:
            strict_yaml.changed_field(words, path, values.plain(value, path), Path.cwd())
        except ValueError as error:
            raise refusal("problem.field", f"{type(self).__name__}: {error}", field=path) from None
        return type(self)(**words)


class Pose(Section, model=cell.PoseFile):
    """A pose: position and roll, pitch, yaw about fixed x, then y, then z; or a ``matrix`` (4, 4), whose
    ``unit`` ("mm", "m" ...) has to be said."""

    def __init__(self, *, matrix: Any = None, unit: str | None = None, **words: Any) -> None:
        if matrix is not None:
            if both := sorted({"xyz_mm", "rpy_deg"} & set(words)):
                what = f"{' and '.join(both)} beside a matrix; give one of them"
                _refuse([Issue("problem.field", what, field=both[0])], "Pose")
            pose = values.rigid_poses(matrix, unit, "Pose.matrix", (4, 4))
            words = {**words, "xyz_mm": pose[:3, 3] / MM, "rpy_deg": to_rpy(pose[:3, :3]) / DEG}
        elif unit is not None:
            _refuse(
                [Issue("problem.field", "unit belongs to a matrix; xyz_mm is in mm", field="unit")], "Pose"
            )
        super().__init__(**words)


class Box(Section, model=cell.BoxFile, kind="box"): ...


class Cylinder(Section, model=cell.RoundFile, kind="cylinder"): ...


class Capsule(Section, model=cell.RoundFile, kind="capsule"): ...


class Sphere(Section, model=cell.SphereFile, kind="sphere"): ...


class Mesh(Section, model=cell.MeshFile, kind="mesh"): ...


class WireHolder(Section, model=cell.WireHolderFile, kind="wire_holder"): ...


class Bow(Section, model=cell.BowFile, kind="bow"): ...


class GripperPlate(Section, model=cell.GripperPlateFile, kind="gripper_plate"): ...


class VacuumCup(Section, model=cell.VacuumCupFile, kind="vacuum_cup"): ...


class BallTool(Section, model=cell.BallToolFile, kind="ball_tool"): ...


class DiskTool(Section, model=cell.DiskToolFile, kind="disk_tool"): ...


class HeatTool(Section, model=cell.HeatToolFile, kind="heat_tool"): ...


class HolderPiece(Section, model=cell.HolderPieceFile): ...


class Mill(Section, model=cell.MillFile, kind="mill"): ...


class Torch(Section, model=cell.TorchFile, kind="torch"): ...


class Knife(Section, model=cell.KnifeFile, kind="knife"): ...


class PlainTool(Section, model=cell.PlainToolFile, kind="plain"): ...


class Stiffness(Section, model=cell.StiffnessFile): ...


class Sag(Section, model=cell.SagFile): ...


class Force(Section, model=loads.ForceFile): ...


class LinkMesh(Section, model=robot_file.LinkMeshFile): ...


class OwnRobot(Section, model=robot_file.OwnRobotFile): ...


class Track(Section, model=rails.TrackFile): ...


class GantryAxis(Section, model=rails.GantryAxisFile): ...


class Turntable(Section, model=axes.TurntableFile): ...


class TiltAxis(Section, model=axes.TiltFile): ...


class Positioner(Section, model=axes.PositionerFile): ...


class TablePlate(Section, model=axes.TurntablePlateFile): ...


class Arm(Section, model=cell.ArmFile): ...


class Obstacle(Section, model=cell.ObstacleFile): ...


class Wires(Section, model=materials.WiresFile): ...


class Handshake(Section, model=controller.HandshakeFile): ...


class Interlock(Section, model=controller.InterlockFile): ...


class Controller(Section, model=controller.ControllerFile): ...


class Cell(Section, model=cell.CellFile):
    """A robot cell: arms, obstacles, grippers and wires at hand, controller."""

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The cell of a file, or a bundled one by its name, such as ``irb140_bow``."""
        named = Path("cells") / f"{path}.yaml"
        found = Path(path) if is_file(Path(path)) else bundled(named)
        if not is_file(found):
            known = ", ".join(sorted(one.stem for one in (data_dir("problems") / "cells").glob("*.yaml")))
            what = f"{path}: no such file, and no cell that is built in; these are {known}"
            raise refusal("problem.missing_file", what, file=str(path))
        document = strict_yaml.read(found)
        return cls(**problem_file.resolved({"cell": document.path.name}, document.path.parent)["cell"])


class Foam(Section, model=stock.FoamReference): ...


class Stock(Section, model=stock.StockFile): ...


class Setup(Section, model=stock.SetupFile): ...


class Clamp(Section, model=sheet.ClampFile): ...


class Sheet(Section, model=sheet.SheetFile): ...


class Settings(Section, model=problem_file.SettingsFile): ...


class FaceMesh(Section, model=part_surfaces.FaceMeshFile): ...


class Rail(Section, model=part_surfaces.RailFile): ...


class Curve(Section, model=part_surfaces.CurveFile): ...


class Region(Section, model=part_surfaces.RegionFile): ...


class Loft(Section, model=part_surfaces.LoftFile): ...


class Front(Section, model=part_surfaces.FrontFile): ...


class Back(Section, model=part_surfaces.BackFile): ...


class RuledMesh(Section, model=part_surfaces.RuledMeshFile): ...


class Strips(Section, model=part_surfaces.StripsFile): ...


class Guide(Section, model=part_ruled.GuideFile): ...


class GuideDxf(Section, model=part_ruled.DxfFile): ...


class Ruled(Section, model=part_ruled.RuledFile): ...


class RhinoCurves(Section, model=rhino.RhinoFile): ...


class RhinoRuled(Section, model=rhino.RhinoRuledFile): ...


class RhinoFace(Section, model=rhino.RhinoFaceFile): ...


class StepRuled(Section, model=step.StepRuledFile): ...


class StepFace(Section, model=step.StepFaceFile): ...


class Airfoil(Section, model=part_ruled.SectionFile): ...


class Wing(Section, model=part_ruled.WingFile): ...


class Circle(Section, model=part.CircleFile): ...


class PlateDxf(Section, model=part.PlateDxfFile): ...


class Outline(Section, model=part.OutlineFile): ...


class Plate(Section, model=part.PlateFile): ...


class SheetMesh(Section, model=sheet.SheetMeshFile): ...


class Part(Section, model=part.PartFile): ...


class Operation(Section):
    """An operation of any process, built-in ones and those of installed packages: ``process`` is its name,
    ``setup`` what the operator changes before it (:class:`Setup`), ``forces`` {arm: :class:`Force`} what the
    work exerts on tools, the rest are the keys of that process."""

    def __init__(self, **words: Any) -> None:
        setup, forces = words.pop("setup", None), words.pop("forces", None)
        super().__init__(**words)
        if forces is not None:
            self._words["forces"] = values.plain(forces, type(self).__name__)
            stated = {"forces": self._words["forces"]}
            _, faults = problem_file.validate(loads.ForcesFile, stated, _document(stated), ())
            _refuse(faults, type(self).__name__)
        if setup is not None:
            if not isinstance(setup, Mapping) or any(not isinstance(key, str) for key in setup):
                what = f"setup: got a {type(setup).__name__}; give a Setup, or a mapping with its keys"
                _refuse([Issue("problem.field", what, field="setup")], type(self).__name__)
            self._words["setup"] = dict(setup if isinstance(setup, Setup) else Setup(**setup))

    def _check(self) -> None:
        known = registry.readers()
        model = self.model or known.get(str(self._words.get("process")))
        if isinstance(model, type):
            _, faults = problem_file.validate(model, self._words, _document(self._words), ())
        else:
            _, faults = problem_file.read_operation(self._words, 0, _document({}), known)
        _refuse(faults, type(self).__name__)


class Wire(Section, model=materials.WireFile): ...


class ElasticWire(Operation, model=hotwire.ElasticWire, process="elastic_wire"): ...


class SurfaceCut(Section, model=hotwire.SurfaceCut): ...


class TrimCut(Section, model=hotwire.TrimCut): ...


class StraightWire(Operation, model=hotwire.Straight, process="straight_wire"): ...


class Adsif(Section, model=forming.Adsif): ...


class Die(Section, model=forming.Die): ...


class Springback(Section, model=forming.Springback): ...


class PartScan(Section, model=forming.PartScan): ...


class ForceBy(Section, model=forming.ForceBy): ...


class Level(Section, model=forming.Level): ...


class Forming(Operation, model=forming.Forming, process="forming"): ...


class FlankCut(Section, model=milling.FlankCut): ...


class LinesCut(Section, model=milling.LinesCut): ...


class EngraveCut(Section, model=milling.EngraveCut): ...


class GCode(Section, model=milling.GCodeFile): ...


class GCodeCut(Section, model=milling.GCodeCut): ...


class Milling(Operation, model=milling.Milling, process="milling"): ...


class TrimCircle(Section, model=trim.CircleFile): ...


class TrimOutline(Section, model=trim.OutlineFile): ...


class Lead(Section, model=trim.LeadFile): ...


class Pierce(Section, model=trim.PierceFile): ...


class TrimTorch(Section, model=trim.TorchCut, kind="torch"): ...


class TrimMill(Section, model=trim.MillCut, kind="mill"): ...


class TrimKnife(Section, model=trim.KnifeCut, kind="knife"): ...


class Trim(Operation, model=trim.Trim, process="trim"): ...


class FreeAxis(Section, model=pose_table.FreeAxis): ...


class Targets(Operation, model=pose_table.Posed, process="targets"):
    """Poses of one's own: a ``file``, or ``poses`` {arm: (N, 4, 4)} in ``unit``, each the TCP's in ``frame``,
    with further ``columns`` (``feed_mm_s``, ``feed_min_mm_s``, ``segment``, ``stop``), (N,) each."""

    def __init__(
        self,
        *,
        poses: Mapping[str, Any] | None = None,
        unit: str | None = None,
        columns: Mapping[str, Any] | None = None,
        **words: Any,
    ) -> None:
        if poses is not None:
            if "file" in words:
                what = "file beside poses; give one of them"
                _refuse([Issue("problem.field", what, field="file")], "Targets")
            file = values.pose_file(poses, unit, {} if columns is None else columns)
            words = {"arms": list(poses), **words, "file": file}
        elif unit is not None or columns is not None:
            what = "unit and columns belong to poses; a file has its own"
            _refuse([Issue("problem.field", what, field="poses")], "Targets")
        super().__init__(**words)


class Problem(Section, model=problem_file.ProblemFile, tandem=1):
    """A whole problem, to be planned, checked or saved; :func:`planner.build` reads it."""

    def __init__(self, **words: Any) -> None:
        if isinstance(words.get("cell"), str | Path):
            words["cell"] = Cell.read(words["cell"])
        super().__init__(**words)

    def _check(self) -> None:
        super()._check()
        for index, one in enumerate(self._words["operations"]):
            faults = problem_file.read_operation(one, index, _document({}), registry.readers())[1]
            faults += problem_file.read_setup(one, index, _document({}))[1]
            faults += problem_file.read_forces(one, index, _document({}))[1]
            _refuse(faults, type(self).__name__)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The problem of a file, or a bundled one by its name, such as ``wing``. Raises ``TandemError``."""
        document = strict_yaml.read(problem_file.find(Path(path)))
        words = problem_file.resolved(document.data, document.path.parent)
        return cls(**{k: v for k, v in words.items() if k not in cls.fixed or v != cls.fixed[k]})

    def document(self) -> Document:
        """The problem as a file would say it, for the reader of problem files. Raises ``TandemError``:
        ``problem.not_yaml`` and ``problem.too_large`` for what no file can say."""
        text = strict_yaml.dump(self._words).encode("utf-8", "surrogatepass")
        most = strict_yaml.MAX_YAML_BYTES
        if len(text) > most:
            what = f"Problem: {len(text) / 1e6:.1f} MB as a file, {most / 1e6:.0f} MB are read"
            hint = "give points as a mesh or a file of their own"
            raise refusal("problem.too_large", f"{what}; {hint}")
        data, _ = strict_yaml.parse(text, "Problem")
        if data != self._words:
            raise refusal("problem.not_yaml", "Problem: a file would not say the same; report this")
        return _document(data)


def _document(data: Mapping[str, Any]) -> Document:
    """Data that come from no file; names in it start at the working directory."""
    return Document(Path.cwd() / "problem.yaml", data, None, b"", file=False)


def _refuse(faults: Sequence[Issue], name: str) -> None:
    if faults:
        subject = f"{name}: " if name else ""
        raise TandemError(
            [Issue(i.code, f"{subject}{i.message}", field=i.field, hint=i.hint) for i in faults]
        )
