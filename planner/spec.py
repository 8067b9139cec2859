"""Problems stated in Python: sections with the keys of a problem file, and arrays and meshes as values.

>>> from planner import spec
>>> base = spec.Pose(xyz_mm=[0, 0, 200])
>>> arm = spec.Arm(name="robot", robot="irb140", base=base, tool=spec.Bow(span_mm=400))
>>> arm["base"] {'xyz_mm': [0, 0, 200]}

Each section takes the keys that ``docs/problem_file.md`` lists for it, with the same units and ranges, and is
checked when it is created. :func:`planner.build` checks what concerns several sections, with the reader of
problem files.

A value may be a plain value, a numpy array, another section, or a mapping with the keys of one. A ``file``
with a ``unit`` may be a mesh: a ``trimesh.Trimesh``, a pair of arrays (vertices (V, 3), faces (F, 3)), or a
grid of points (N, M, 3), whose normal is (along N) x (along M). Relative file names refer to the working
directory. Sections are immutable: :meth:`Section.replace` and :meth:`Section.changed` return new ones.
"""

import copy
import inspect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import BaseModel

from planner.catalogue.robots import bundled_path, data_dir
from planner.files import is_file
from planner.geometry.arrays import to_rpy
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error
from planner.processes import registry
from planner.processes.forming.plan import operation as forming
from planner.processes.hotwire.plan import operation as hotwire
from planner.processes.milling.plan import operation as milling
from planner.processes.poses.plan import job as pose_table
from planner.processes.trim.plan import operation as trim
from planner.reading import (
    cell,
    controller,
    materials,
    part,
    part_ruled,
    part_surfaces,
    process_forces,
    rail_axes,
    rhino,
    robot_file,
    rotary_axes,
    sheet,
    step,
    stock,
    strict_yaml,
    values,
)
from planner.reading import problem as problem_file
from planner.reading.strict_yaml import Document


class Section(Mapping[str, Any]):
    """A section of a problem file: a mapping of its keys to plain values, as in YAML.

    Raises:
        TandemError: ``problem.field`` or ``problem.not_finite``, with the name of the section.
    """

    model: ClassVar[type[BaseModel] | None] = None
    fixed: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, model: type[BaseModel] | None = None, **fixed: Any) -> None:
        """Give a section the fields and the signature of the model that checks it.

        ``fixed`` are keys with values that the section always has, such as ``kind``.
        """
        super().__init_subclass__()
        if model is None:
            return
        cls.model, cls.fixed = model, fixed
        model_doc = inspect.getdoc(model) or ""
        # A docstring that only repeats the start of the model's docstring is replaced by the latter.
        if " ".join(model_doc.split()).startswith(" ".join((cls.__doc__ or "").split())):
            cls.__doc__ = model_doc
        parameters = [p for p in inspect.signature(model).parameters.values() if p.name not in fixed]
        cls.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]

    def __init__(self, **words: Any) -> None:
        self._words: dict[str, Any] = {**self.fixed, **values.to_plain(dict(words), type(self).__name__)}
        self._check()

    def _check(self) -> None:
        """Raise ``TandemError`` with the faults that the section's model finds."""
        if self.model is not None:
            _, faults = problem_file.validate(self.model, self._words, _document(self._words), ())
            _raise_faults(faults, type(self).__name__)

    def __setattr__(self, name: str, value: Any) -> None:
        if name != "_words":
            raise AttributeError(
                f"a {type(self).__name__} is immutable; replace({name}=...) returns a changed one"
            )
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
        """Return the section with some keys changed. Raises as the section itself."""
        return type(self)(**{**{k: v for k, v in self._words.items() if k not in self.fixed}, **words})

    def changed(self, path: str, value: Any) -> Self:
        """Return the section with one field changed.

        Args:
            path: Path of the field, such as ``stock.size_mm`` or ``operations.0.feed_mm_s``; entries of lists
                by number or by their ``name``.
            value: New value.

        Raises:
            TandemError: As the section itself, and ``problem.field`` for an unknown path.
        """
        words = copy.deepcopy({k: v for k, v in self._words.items() if k not in self.fixed})
        try:
            strict_yaml.set_field(words, path, values.to_plain(value, path), Path.cwd())
        except ValueError as error:
            raise issue_error("problem.field", f"{type(self).__name__}: {error}", field=path) from None
        return type(self)(**words)


class Pose(Section, model=cell.PoseFile):
    """A pose: position and roll, pitch, yaw about fixed x, then y, then z; or a matrix.

    Args:
        matrix: Matrix (4, 4), instead of position and angles.
        unit: Unit of the matrix ("mm", "m", ...); required with it.
    """

    def __init__(self, *, matrix: Any = None, unit: str | None = None, **words: Any) -> None:
        if matrix is not None:
            conflicts = sorted({"xyz_mm", "rpy_deg"} & set(words))
            if conflicts:
                message = f"{' and '.join(conflicts)} together with a matrix; give one of them"
                _raise_faults([Issue("problem.field", message, field=conflicts[0])], "Pose")
            pose = values.rigid_poses(matrix, unit, "Pose.matrix", (4, 4))
            words = {**words, "xyz_mm": pose[:3, 3] / MM, "rpy_deg": to_rpy(pose[:3, :3]) / DEG}
        elif unit is not None:
            _raise_faults(
                [Issue("problem.field", "unit is for a matrix; xyz_mm is in mm", field="unit")], "Pose"
            )
        super().__init__(**words)


class Box(Section, model=cell.BoxFile, kind="box"):
    """A box centred on its pose."""


class Cylinder(Section, model=cell.RoundFile, kind="cylinder"):
    """A cylinder along z, centred on its pose."""


class Capsule(Section, model=cell.RoundFile, kind="capsule"):
    """A capsule along z, centred on its pose."""


class Sphere(Section, model=cell.SphereFile, kind="sphere"):
    """A sphere."""


class Mesh(Section, model=cell.MeshFile, kind="mesh"):
    """A mesh file in a stated unit."""


class WireHolder(Section, model=cell.WireHolderFile, kind="wire_holder"):
    """The built-in wire holder with a sliding clamp."""


class Bow(Section, model=cell.BowFile, kind="bow"):
    """The built-in bow with a straight hot wire; 400 x 400 mm and 650 x 650 mm are common sizes."""


class GripperPlate(Section, model=cell.GripperPlateFile, kind="gripper_plate"):
    """The built-in plate with needles that holds a block by its bottom face."""


class VacuumCup(Section, model=cell.VacuumCupFile, kind="vacuum_cup"):
    """The built-in vacuum cup that holds a block by its bottom face."""


class BallTool(Section, model=cell.BallToolFile, kind="ball_tool"):
    """The built-in ball tool for sheets, on a shaft of the ball's or another radius."""


class DiskTool(Section, model=cell.DiskToolFile, kind="disk_tool"):
    """The built-in flat disk that supports the border of a part while it is formed."""


class HeatTool(Section, model=cell.HeatToolFile, kind="heat_tool"):
    """The built-in heat gun or laser head."""


class HolderPiece(Section, model=cell.HolderPieceFile):
    """A piece of a milling tool's holder, a cylinder."""


class Mill(Section, model=cell.MillFile, kind="mill"):
    """The built-in milling tool: cutter, holder and spindle."""


class Torch(Section, model=cell.TorchFile, kind="torch"):
    """The built-in torch: a body with a conical nozzle."""


class Knife(Section, model=cell.KnifeFile, kind="knife"):
    """The built-in knife: a blade in a round body."""


class PlainTool(Section, model=cell.PlainToolFile, kind="plain"):
    """Any tool: TCP and shapes in the flange frame, mass, centre of gravity."""


class Stiffness(Section, model=cell.StiffnessFile):
    """Stiffness of the drives as identified on this individual robot, with rigid links."""


class Sag(Section, model=cell.SagFile):
    """Targets are commanded so that the sagged arm reaches the nominal pose."""


class Force(Section, model=process_forces.ForceFile):
    """Force of the process on a tool at its TCP while it works, measured or calculated."""


class LinkMesh(Section, model=robot_file.LinkMeshFile):
    """Location of a mesh of a URDF."""


class OwnRobot(Section, model=robot_file.OwnRobotFile):
    """A custom robot: its URDF, and what a URDF does not state."""


class Track(Section, model=rail_axes.TrackFile):
    """A linear track under an arm."""


class GantryAxis(Section, model=rail_axes.GantryAxisFile):
    """One axis of a gantry."""


class Turntable(Section, model=rotary_axes.TurntableFile):
    """A turntable under the block, which turns it from station to station between operations."""


class TiltAxis(Section, model=rotary_axes.TiltFile):
    """The tilt axis of a positioner, fixed in the world."""


class Positioner(Section, model=rotary_axes.PositionerFile):
    """A tilt-turn positioner under the block: a turntable on a tilt axis, in one mechanical unit."""


class TablePlate(Section, model=rotary_axes.TurntablePlateFile):
    """The plate of a turntable, a cylinder under its centre."""


class Arm(Section, model=cell.ArmFile):
    """One robot: catalogue name, base, tool, home joints as the controller shows them."""


class Obstacle(Section, model=cell.ObstacleFile):
    """A fixed body: its shapes are placed in the world."""


class Wires(Section, model=materials.WiresFile):
    """Available wires of one section, one for each of the lengths."""


class Handshake(Section, model=controller.HandshakeFile):
    """How two controllers synchronise that share only digital signals."""


class Interlock(Section, model=controller.InterlockFile):
    """Conditions of power besides the program."""


class Controller(Section, model=controller.ControllerFile):
    """Names that the programs use, and the number of controllers."""


class Cell(Section, model=cell.CellFile):
    """A robot cell: arms, obstacles, available grippers and wires, controller."""

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read the cell of a file, or a bundled one by its name, such as ``irb140_bow``."""
        file = Path(path) if is_file(Path(path)) else bundled_path(Path("cells") / f"{path}.yaml")
        if not is_file(file):
            bundled_names = sorted(
                file_path.stem for file_path in (data_dir("problems") / "cells").glob("*.yaml")
            )
            message = f"{path}: no such file or built-in cell; built-in cells are {', '.join(bundled_names)}"
            raise issue_error("problem.missing_file", message, file=str(path))
        document = strict_yaml.read(file)
        return cls(**problem_file.resolve_files({"cell": document.path.name}, document.path.parent)["cell"])


class Foam(Section, model=stock.FoamReference):
    """A custom foam, from a file that ``tandem kerf fit`` writes."""


class Stock(Section, model=stock.StockFile):
    """The block and its pose."""


class Setup(Section, model=stock.SetupFile):
    """What the operator changes before an operation."""


class Clamp(Section, model=sheet.ClampFile):
    """The frame that clamps the sheet all around its opening, on both sides."""


class Sheet(Section, model=sheet.SheetFile):
    """A metal sheet, clamped along its rim."""


class Settings(Section, model=problem_file.SettingsFile):
    """Limits that planning and proof share."""


class FaceMesh(Section, model=part_surfaces.FaceMeshFile):
    """An open mesh in an OBJ, STL or PLY file, in a stated unit, or in a GLB or 3MF file, in its own unit."""


class Rail(Section, model=part_surfaces.RailFile):
    """A horizontal arc about ``centre_mm``."""


class Curve(Section, model=part_surfaces.CurveFile):
    """One profile or section: control points of a Bezier curve or of a clamped cubic B-spline."""


class Region(Section, model=part_surfaces.RegionFile):
    """The part of the surface that is the face: ``u`` along the row of curves, ``v`` along each curve."""


class Loft(Section, model=part_surfaces.LoftFile):
    """A loft: profiles (out, up) along an arc ``rail``, or ``sections`` given as curves in space."""


class Front(Section, model=part_surfaces.FrontFile):
    """The front face: exactly one of ``loft``, ``mesh``, ``rhino`` and ``step``."""


class Back(Section, model=part_surfaces.BackFile):
    """The back face: the front offset inward by ``offset_mm``, or a ``mesh``, ``rhino`` or ``step`` face."""


class RuledMesh(Section, model=part_surfaces.RuledMeshFile):
    """A mesh with four corners that is a ruled surface within ``tolerance_mm``."""


class Strips(Section, model=part_surfaces.StripsFile):
    """A free-form surface cut into ruled strips."""


class Guide(Section, model=part_ruled.GuideFile):
    """A guide curve: exactly one of points, control points of a spline, and a DXF or Rhino file."""


class GuideDxf(Section, model=part_ruled.DxfFile):
    """Curves of a DXF file."""


class Ruled(Section, model=part_ruled.RuledFile):
    """A ruled surface between two guides, ``start`` and ``end``, or a ruled face of a CAD file."""


class RhinoCurves(Section, model=rhino.RhinoFile):
    """Objects of a Rhino file (3DM): visible ones that match the given ``layer``, ``name`` and ``colour``."""


class RhinoRuled(Section, model=rhino.RhinoRuledFile):
    """A ruled face of a Rhino file: one face, whole or trimmed along its parameter lines."""


class RhinoFace(Section, model=rhino.RhinoFaceFile):
    """A face or a mesh of a Rhino file: one object."""


class StepRuled(Section, model=step.StepRuledFile):
    """A ruled face of a STEP or IGES file, whole or trimmed along its parameter lines."""


class StepFace(Section, model=step.StepFaceFile):
    """A face of a STEP or IGES file, whole or trimmed along its parameter lines."""


class Airfoil(Section, model=part_ruled.SectionFile):
    """An airfoil with its chord: NACA digits in quotes, or a file in Selig's or Lednicer's format."""


class Wing(Section, model=part_ruled.WingFile):
    """A wing panel between two sections."""


class Circle(Section, model=part.CircleFile):
    """A circle."""


class PlateDxf(Section, model=part.PlateDxfFile):
    """Closed curves of a DXF file, seen along z."""


class Outline(Section, model=part.OutlineFile):
    """A closed outline: exactly one of points, control points of a closed spline, and a circle."""


class Plate(Section, model=part.PlateFile):
    """Outlines cut through the block from bottom to top."""


class SheetMesh(Section, model=sheet.SheetMeshFile):
    """A mesh of one face of the formed sheet."""


class Part(Section, model=part.PartFile):
    """The part to make, given by exactly one of its kinds."""


class Operation(Section):
    """An operation of any process, built-in or from an installed package.

    Args:
        process: Name of the process.
        setup: Changes that the operator makes before it (:class:`Setup`).
        forces: {arm: :class:`Force`} of the process on tools.
        words: Keys of that process.
    """

    def __init__(self, **words: Any) -> None:
        setup, forces = words.pop("setup", None), words.pop("forces", None)
        super().__init__(**words)
        if forces is not None:
            self._words["forces"] = values.to_plain(forces, type(self).__name__)
            forces_data = {"forces": self._words["forces"]}
            document = _document(forces_data)
            _, faults = problem_file.validate(process_forces.ForcesFile, forces_data, document, ())
            _raise_faults(faults, type(self).__name__)
        if setup is not None:
            if not isinstance(setup, Mapping) or any(not isinstance(key, str) for key in setup):
                message = f"setup: got a {type(setup).__name__}; give a Setup, or a mapping with its keys"
                _raise_faults([Issue("problem.field", message, field="setup")], type(self).__name__)
            self._words["setup"] = dict(setup if isinstance(setup, Setup) else Setup(**setup))

    def _check(self) -> None:
        """Raise ``TandemError`` with the faults that the reader of the process finds."""
        readers = registry.readers()
        model = self.model or readers.get(str(self._words.get("process")))
        if isinstance(model, type):
            _, faults = problem_file.validate(model, self._words, _document(self._words), ())
        else:
            _, faults = problem_file.read_operation(self._words, 0, _document({}), readers)
        _raise_faults(faults, type(self).__name__)


class Wire(Section, model=materials.WireFile):
    """One wire: its section and its length."""


class ElasticWire(Operation, model=hotwire.ElasticWire, process="elastic_wire"):
    """Two arms bend one hot wire and sweep it through the block along the faces of the part."""


class SurfaceCut(Section, model=hotwire.SurfaceCut):
    """One ruled surface of the part."""


class TrimCut(Section, model=hotwire.TrimCut):
    """Cut off the oversize of the block at the named sides, so that the datum block remains."""


class StraightWire(Operation, model=hotwire.Straight, process="straight_wire"):
    """One arm moves a bow with a straight hot wire along the ruled surfaces of the part."""


class Adsif(Section, model=forming.Adsif):
    """Accumulative forming: selects a solution of the response table, and states the compliance of the tools.

    ``file``: a custom table with the columns of the built-in one. Its conditions are stated in the file.
    """


class Die(Section, model=forming.Die):
    """The fixed die of ``tpif``: a mesh in the sheet's frame, on the side of the sheet away from the tool."""


class Springback(Section, model=forming.Springback):
    """Springback compensation: both tools go deeper by the expected springback of the sheet."""


class PartScan(Section, model=forming.PartScan):
    """Scan of a part that was formed before: ``file`` as it was given to `tandem adjust`."""


class ForceBy(Section, model=forming.ForceBy):
    """Forces on the sheet that vary over a part, instead of ``force_n``."""


class Level(Section, model=forming.Level):
    """A single level of one pass, in the sheet as the previous levels have left it."""


class Forming(Operation, model=forming.Forming, process="forming"):
    """Incremental forming of the clamped sheet by the tools of one or two arms."""


class FlankCut(Section, model=milling.FlankCut):
    """The cutter's side along a ruled surface of the part, or its axis along the two guides themselves."""


class LinesCut(Section, model=milling.LinesCut):
    """Parallel lines over the part's front, spaced by a stepover or by the height of the ridges between them.

    ``angle_deg`` rotates the lines about the block's z from its x. The tool's axis is the surface's normal,
    tilted forward along the feed by ``lead_deg`` and to the left by ``tilt_deg``; or upright.
    """


class EngraveCut(Section, model=milling.EngraveCut):
    """Curves that are projected along z onto the part's front and engraved there by ``depth_mm``."""


class GCode(Section, model=milling.GCodeFile):
    """A G-code file whose X Y Z are positions of the cutter's tip in the part."""


class GCodeCut(Section, model=milling.GCodeCut):
    """The cuts of a G-code file, at its own feeds."""


class Milling(Operation, model=milling.Milling, process="milling"):
    """One arm mills the block with the side or the end of a cutter, cut after cut in the given order."""


class TrimCircle(Section, model=trim.CircleFile):
    """A circle in the sheet's plane."""


class TrimOutline(Section, model=trim.OutlineFile):
    """A closed curve that is projected along the sheet's z onto its formed face and cut there."""


class Lead(Section, model=trim.LeadFile):
    """How the slot starts and ends, in the waste."""


class Pierce(Section, model=trim.PierceFile):
    """How the sheet is pierced, with the torch at rest in the waste."""


class TrimTorch(Section, model=trim.TorchCut, kind="torch"):
    """A torch cuts, by an arc, a beam or a jet."""


class TrimMill(Section, model=trim.MillCut, kind="mill"):
    """A mill cuts, whose kerf is its cutter's diameter."""


class TrimKnife(Section, model=trim.KnifeCut, kind="knife"):
    """A knife cuts: its blade is in the plane of the curve, its edge ahead, and removes nothing."""


class Trim(Operation, model=trim.Trim, process="trim"):
    """One arm cuts closed curves out of the formed sheet ``by`` a torch, a mill or a knife."""


class FreeAxis(Section, model=pose_table.FreeAxis):
    """A free rotation about, or translation along, an axis of the tool frame."""


class Targets(Operation, model=pose_table.Posed, process="targets"):
    """Poses from a ``file``, or given as arrays.

    Args:
        poses: {arm: (N, 4, 4)} TCP poses in ``frame``.
        unit: Unit of the poses.
        columns: Further columns (``feed_mm_s``, ``feed_min_mm_s``, ``segment``, ``stop``), (N,) each.
    """

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
                message = "file together with poses; give one of them"
                _raise_faults([Issue("problem.field", message, field="file")], "Targets")
            file = values.write_pose_file(poses, unit, {} if columns is None else columns)
            words = {"arms": list(poses), **words, "file": file}
        elif unit is not None or columns is not None:
            message = "unit and columns are for poses; a file has its own"
            _raise_faults([Issue("problem.field", message, field="poses")], "Targets")
        super().__init__(**words)


class Problem(Section, model=problem_file.ProblemFile, tandem=1):
    """A whole problem, to be planned, checked or saved. :func:`planner.build` reads it."""

    def __init__(self, **words: Any) -> None:
        if isinstance(words.get("cell"), str | Path):
            words["cell"] = Cell.read(words["cell"])
        super().__init__(**words)

    def _check(self) -> None:
        """Raise ``TandemError`` with the faults of the problem's keys, or of its first faulty operation."""
        super()._check()
        for index, operation in enumerate(self._words["operations"]):
            faults = problem_file.read_operation(operation, index, _document({}), registry.readers())[1]
            faults += problem_file.read_setup(operation, index, _document({}))[1]
            faults += problem_file.read_forces(operation, index, _document({}))[1]
            _raise_faults(faults, type(self).__name__)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read the problem of a file, or a bundled one by its name, such as ``wing``.

        Raises:
            TandemError: If it cannot be read.
        """
        document = strict_yaml.read(problem_file.find_problem(Path(path)))
        words = problem_file.resolve_files(document.data, document.path.parent)
        return cls(**{k: v for k, v in words.items() if k not in cls.fixed or v != cls.fixed[k]})

    def document(self) -> Document:
        """Return the problem in the form of a file, for the reader of problem files.

        Raises:
            TandemError: ``problem.not_yaml`` or ``problem.too_large`` if no file can state it.
        """
        text = strict_yaml.dump(self._words).encode("utf-8", "surrogatepass")
        max_bytes = strict_yaml.MAX_YAML_BYTES
        if len(text) > max_bytes:
            message = f"Problem: {len(text) / 1e6:.1f} MB as a file, allowed {max_bytes / 1e6:.0f} MB"
            hint = "give points as a mesh or a separate file"
            raise issue_error("problem.too_large", f"{message}; {hint}")
        data, _ = strict_yaml.parse(text, "Problem")
        if data != self._words:
            raise issue_error("problem.not_yaml", "Problem: a file would not state the same. Report this")
        return _document(data)


def _document(data: Mapping[str, Any]) -> Document:
    """Return a document of data without a file. Relative file names in it refer to the working directory."""
    return Document(Path.cwd() / "problem.yaml", data, root=None, text=b"", file=False)


def _raise_faults(faults: Sequence[Issue], name: str) -> None:
    """Raise ``TandemError`` if there are faults, with the name of the section before each message."""
    if faults:
        subject = f"{name}: " if name else ""
        raise TandemError(
            [Issue(i.code, f"{subject}{i.message}", field=i.field, hint=i.hint) for i in faults]
        )
