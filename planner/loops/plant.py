"""Simulated sheets and robots (plants) with known springback, to test the correction from level to level.

The plants share no code with the correction: their springback has separate tables, interpolation and force
law. At each position of a level the commanded depth X_c of the tool, the depth X of the part after the tool
releases the sheet, and the force F are in balance:

    X_c = X + S(F) + (1 - compensated) F / k,    F = F_s (1 - exp(-z / z_0)) ((X - X_previous) / dz)^m

Here S is the springback, k the stiffness of the robot, F_s the steady force, z the nominal depth, z_0 the
depth in which the tool runs in, and dz the depth between levels. S comes from shell models of finely meshed
sheets (``planner/data/loop_plant.json``, made by ``python -m bench.plant_shells``) with another thickness and
clamp stiffness than the correction assumes, or from curves of the plant's file. Thickness, clamp, force and
stiffness of each sheet are drawn at random with its seed. Force law: scallops of a ball grow with the square
of the step, and force with their 0.09th power (m = 0.18).
"""

import dataclasses
import functools
import itertools
import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from planner.geometry.arrays import BoolArray, FloatArray
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Name, Strict

TABLE_FILE: Final = Path(__file__).parents[1] / "data" / "loop_plant.json"
"""File with the table of springback from shell models."""
MM_IN_M: Final = 1e-3
"""One millimetre [m]."""
MAX_CONTOUR_DISTANCE_M: Final = 3e-3
"""Maximum distance [m] of a path from the contour of a shape of the table."""
_HALVINGS: Final = 26
"""Number of bisection steps with which the balance is found."""
_MAX_STEP_RATIO: Final = 6.0
"""Maximum step in a level over the depth between levels; larger steps are not considered."""

Fraction = Annotated[float, Field(ge=0, le=0.5)]
FactorRange = tuple[Annotated[float, Field(gt=0, le=10)], Annotated[float, Field(gt=0, le=10)]]
ClampStiffness = Annotated[float, Field(ge=0, le=60)]


class PlantCurveFile(Strict):
    """Springback at a depth, as measured on a test piece or assumed."""

    depth_mm: Annotated[float, Field(ge=0, le=1000)]
    forces_n: Annotated[list[Annotated[float, Field(gt=0, le=1e6)]], Field(min_length=1, max_length=50)]
    springback_mm: Annotated[list[Annotated[float, Field(gt=0, le=1000)]], Field(min_length=1, max_length=50)]

    @model_validator(mode="after")
    def _grows(self) -> "PlantCurveFile":
        if len(self.forces_n) != len(self.springback_mm):
            raise ValueError(f"{len(self.forces_n)} forces_n, but {len(self.springback_mm)} springback_mm")
        for row in (self.forces_n, self.springback_mm):
            if any(b <= a for a, b in itertools.pairwise(row)):
                raise ValueError("forces_n and springback_mm must increase")
        return self


class PlantFile(Strict):
    """A plant: sheets of a table, or of curves, and what forms them.

    Pairs are the minimum and maximum that sheets draw.
    """

    tandem_plant: Literal[1]
    name: Name = "plant"
    sheet: Literal["cone", "pyramid"] | None = None
    curves: Annotated[list[PlantCurveFile] | None, Field(min_length=1, max_length=100)] = None
    thickness: Annotated[FactorRange, Field(description="over the nominal one")] = (0.91, 0.99)
    thickness_round: Annotated[Fraction, Field(description="amplitude round the sheet")] = 0.025
    border_n_mm2: Annotated[
        tuple[ClampStiffness, ClampStiffness], Field(description="spring of the clamp in plane")
    ] = (0.0, 15.0)
    springback: Annotated[FactorRange, Field(description="factor on all springback")] = (1.0, 1.0)
    force_n: Annotated[float, Field(gt=0, le=1e5, description="steady, along z")] = 620.0
    force_spread: Annotated[Fraction, Field(description="from sheet to sheet, at most")] = 0.08
    force_round: Annotated[Fraction, Field(description="amplitude round the sheet")] = 0.05
    force_corner: Annotated[Fraction, Field(description="additional fraction at the middles of corners")] = (
        0.0
    )
    force_exponent: Annotated[float, Field(gt=0, le=2)] = 0.18
    run_in_mm: Annotated[float, Field(gt=0, le=100)] = 2.5
    stiffness_n_mm: Annotated[
        float, Field(gt=0, le=1e6, description="of the robot with its tool, along z")
    ] = 500.0
    compensated: Annotated[
        tuple[Annotated[float, Field(ge=0, le=2)], Annotated[float, Field(ge=0, le=2)]],
        Field(description="fraction of the robot's deflection that its controller compensates"),
    ] = (0.9, 0.9)
    noise: Annotated[Fraction, Field(description="of the force, one standard deviation")] = 0.01
    lift_noise_mm: Annotated[float, Field(ge=0, le=1)] = 0.02

    @model_validator(mode="after")
    def _one_truth(self) -> "PlantFile":
        if (self.sheet is None) == (self.curves is None):
            raise ValueError("give either sheet or curves")
        for name in ("thickness", "border_n_mm2", "springback", "compensated"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: the minimum comes first")
        return self


def read_plant(path: Path) -> PlantFile:
    """Read the plant of a YAML file.

    Raises:
        TandemError: A field is invalid (``forming.loop_plant``, one issue for each), or the file cannot be
            read, see `strict_yaml.read_file`.
    """
    return strict_yaml.read_file(PlantFile, path, "forming.loop_plant")


@dataclasses.dataclass(frozen=True)
class SpringbackTruth:
    """True springback of a plant as a table.

    Contours of the shapes are squares with rounded corners: all points at one distance from a smaller square.

    Attributes:
        depth: Depths (D,) [m].
        load: Loads, increasing from 0 (L,) [N].
        value: Springback by depth, position (walls, then corners), thickness, stiffness of the clamp and load
            (D, W, T, B, L) [m].
        thickness_ratio: Thickness over the nominal one (T,) [-].
        spring: Stiffness of the clamp per length of the border (B,) [N/mm^2].
        core: Half side of the smaller square [m], inf for a plant by curves.
        around: Distance of the contour from the smaller square at depth 0 [m], inf for a plant by curves.
    """

    depth: FloatArray
    load: FloatArray
    value: FloatArray
    thickness_ratio: FloatArray
    spring: FloatArray
    core: float
    around: float


@functools.cache
def springback_table() -> dict[str, Any]:
    """Return the table of springback from shell models as its file states it, in mm and N."""
    return dict(json.loads(TABLE_FILE.read_text(encoding="utf-8")))


def plant_truth(file: PlantFile) -> SpringbackTruth:
    """Return the true springback of a simulated plant, as a table over depth, load and other properties.

    It comes from the curves in the plant's file, which depend only on depth and load, or otherwise from the
    bundled table of its sheet's shape.
    """
    if file.curves is not None:
        load = np.unique(np.concatenate([[0.0], *(curve.forces_n for curve in file.curves)]))
        curves = sorted(file.curves, key=lambda curve: curve.depth_mm)
        springback_mm = [
            np.interp(load, [0.0, *curve.forces_n], [0.0, *curve.springback_mm]) for curve in curves
        ]
        value = MM_IN_M * np.array(springback_mm)[:, None, None, None]
        depth = MM_IN_M * np.array([curve.depth_mm for curve in curves])
        return SpringbackTruth(depth, load, value, np.ones(1), np.zeros(1), np.inf, np.inf)
    data = springback_table()
    shape = data["shapes"][file.sheet]
    value = MM_IN_M * np.array(shape["true_mm"])
    value = np.concatenate([np.zeros((*value.shape[:-1], 1)), value], axis=-1)
    return SpringbackTruth(
        MM_IN_M * np.array(data["depth_mm"]),
        np.concatenate([[0.0], data["load_n"]]),
        value,
        np.array(data["thickness"]),
        np.array(data["spring_n_mm2"]),
        MM_IN_M * shape["core_mm"],
        MM_IN_M * shape["around_mm"],
    )


def corner_fraction(known: SpringbackTruth, position: FloatArray) -> FloatArray:
    """Return the weight (J,) of a corner's springback at positions (J, 2) [m], against that of walls.

    It is 0 at walls and 1 at the middle of a corner. ``known`` is the true springback of the plant.
    """
    if known.value.shape[1] == 1:
        return np.zeros(len(position))
    excess = np.maximum(np.abs(position) - known.core, 0.0)
    angle = np.arctan2(excess.min(axis=1), excess.max(axis=1))
    return np.asarray(np.sin(2.0 * angle))


def contour_distance(known: SpringbackTruth, position: FloatArray, depth: float) -> float:
    """Return the largest distance [m] of positions (J, 2) [m] from the contour of the table at a depth.

    Walls are at 45 deg, so the contour shrinks by the depth. ``known`` is the true springback of the plant.
    """
    if not np.isfinite(known.around):
        return 0.0
    excess = np.maximum(np.abs(position) - known.core, 0.0)
    return float(np.abs(np.hypot(excess[:, 0], excess[:, 1]) - (known.around - depth)).max())


class PlantSheets:
    """N sheets of a plant, formed level by level at J positions each.

    Attributes:
        depth: Depth of the part at each position after the last level (N, J) [m].
        force: Force at each position in the last level (N, J) [N].
    """

    def __init__(self, file: PlantFile, seeds: FloatArray | list[int], positions: FloatArray) -> None:
        """Create the sheets.

        Args:
            file: The plant.
            seeds: Integer seeds (N,).
            positions: Positions of the first level in plan view (J, 2) [m].
        """
        self._file, self._known, self._positions = file, plant_truth(file), positions
        self._random = [np.random.default_rng([2002, int(seed)]) for seed in seeds]
        polar_angle = np.arctan2(positions[:, 1], positions[:, 0])
        draws = [self._draw_sheet(random, polar_angle) for random in self._random]
        self._thickness, self._factor, self._steady_force = (
            np.stack([draw[k] for draw in draws]) for k in (0, 1, 2)
        )
        self._spring, self._compliance = (np.array([draw[k] for draw in draws])[:, None] for k in (3, 4))
        self.factor: FloatArray = self._factor[:, 0]
        """The factor (N,) on springback that each sheet has drawn."""
        self.depth = np.zeros(self._steady_force.shape)
        self.force = np.zeros(self._steady_force.shape)

    def _draw_sheet(
        self, random: np.random.Generator, polar_angle: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
        """Draw the random properties of one sheet.

        Returns:
            Thickness ratio, factor on springback and steady force [N] by position (J,), stiffness of the
            clamp [N/mm^2], and uncompensated compliance of the robot [m/N].
        """
        file = self._file
        mean_thickness = random.uniform(*file.thickness)
        spring = random.uniform(*file.border_n_mm2)
        factor = random.uniform(*file.springback)
        force = file.force_n * random.uniform(1.0 - file.force_spread, 1.0 + file.force_spread)
        uncompensated = 1.0 - random.uniform(*file.compensated)
        phase = random.uniform(0.0, 2.0 * np.pi, 2)
        # rolled sheet: thickness and strength have two maxima around the sheet
        thickness = mean_thickness * (1.0 + file.thickness_round * np.cos(2.0 * polar_angle - phase[0]))
        local_force = force * (1.0 + file.force_round * np.cos(2.0 * polar_angle - phase[1]))
        compliance = uncompensated / file.stiffness_n_mm * MM_IN_M
        return thickness, np.full(len(polar_angle), factor), local_force, spring, compliance

    def true_curves(self, depth: float, position: FloatArray) -> FloatArray:
        """Return the true springback S (N, J, L) [m] of N sheets under the L loads of the table.

        It is interpolated in the table at a depth [m] and at J positions (J, 2) [m] in plan view.
        """
        truth = self._known
        depth_weights = _interpolation_weights(truth.depth, np.array([depth]))[0]
        value = np.einsum("d,dwtbl->wtbl", depth_weights, truth.value)
        if len(truth.thickness_ratio) > 1:
            spring = _interpolation_weights(np.sqrt(truth.spring), np.sqrt(self._spring[:, 0]))
            value = np.einsum("nb,wtbl->nwtl", spring, value)
            thick = _interpolation_weights(np.log(truth.thickness_ratio), np.log(self._thickness.reshape(-1)))
            thick = thick.reshape(*self._thickness.shape, -1)
            by_corner = np.einsum("njt,nwtl->njwl", thick, value)
        else:
            # thinner sheets spring back more; a curve has no table for this, so an exponent of -1.16 is used
            by_corner = value[None, None, :, 0, 0] * (self._thickness**-1.16)[:, :, None, None]
        corner = corner_fraction(truth, position)[:, None]
        springback = by_corner[:, :, 0] * (1.0 - corner) + by_corner[:, :, -1] * corner
        return np.asarray(springback * self._factor[:, :, None])

    def form_level(self, depth: float, step: float, command: FloatArray, position: FloatArray) -> BoolArray:
        """Form a level, after which `depth` and `force` are those of this level.

        The balance at each position is found by bisection of the step that the part makes in this level.

        Args:
            depth: Nominal depth [m].
            step: Depth from the previous level [m].
            command: Commanded depth of the tools below the flat sheet (N, J) [m].
            position: Positions in plan view (J, 2) [m].

        Returns:
            Whether the tools had no contact at each position (N, J).
        """
        file, curve = self._file, self.true_curves(depth, position)
        max_force = self._steady_force * (1.0 + file.force_corner * corner_fraction(self._known, position))
        max_force = max_force * (1.0 - np.exp(-depth / (file.run_in_mm * MM_IN_M)))
        previous_depth: FloatArray = self.depth
        low, high = np.zeros(previous_depth.shape), np.full(previous_depth.shape, _MAX_STEP_RATIO * step)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            force = max_force * (middle / step) ** file.force_exponent
            is_too_deep = (
                previous_depth + middle + self._springback_of_curves(curve, force) + self._compliance * force
                > command
            )
            low, high = np.where(is_too_deep, low, middle), np.where(is_too_deep, middle, high)
        self.depth = previous_depth + low
        self.force = np.where(low > 0.0, max_force * (low / step) ** file.force_exponent, 0.0)
        return np.asarray(low <= 0.0)

    def true_springback(self, depth: float, position: FloatArray, force: FloatArray) -> FloatArray:
        """Return true S (N, J) [m] at a depth [m] and positions (J, 2) [m] under forces (N, J) [N]."""
        return self._springback_of_curves(self.true_curves(depth, position), force)

    def _springback_of_curves(self, curve: FloatArray, force: FloatArray) -> FloatArray:
        """Return S (N, J) from curves (N, J, L): linear in F^0.6, with the last piece extrapolated."""
        load = self._known.load**0.6
        x = force**0.6
        piece = np.clip(np.searchsorted(load, x) - 1, 0, len(load) - 2)
        fraction = (x - load[piece]) / (load[piece + 1] - load[piece])
        low, high = (np.take_along_axis(curve, (piece + k)[..., None], axis=-1)[..., 0] for k in (0, 1))
        return np.asarray(low + fraction * (high - low))

    def measured_force(self) -> FloatArray:
        """Return the force (N, J) [N] in the last level as a sensor measures it, with noise."""
        noise = self._noise()
        return np.asarray(np.maximum(self.force * (1.0 + self._file.noise * noise), 0.0))

    def measured_lift(self, depth: float, position: FloatArray) -> FloatArray:
        """Return the springback (N, J) [m] that a lift of the tool shows at positions (J, 2), with noise."""
        true = self.true_springback(depth, position, self.force)
        noise = self._file.lift_noise_mm * MM_IN_M * self._noise()
        return np.asarray(np.maximum(true + noise, 0.0))

    def _noise(self) -> FloatArray:
        """Draw standard normal noise (N, J), each sheet with its own generator."""
        count = len(self._positions)
        return np.stack([random.normal(size=count) for random in self._random])


def _interpolation_weights(known: FloatArray, queries: FloatArray) -> FloatArray:
    """Return the weights (W, K) with which values at ``known`` (K,) are interpolated at ``queries`` (W,).

    They are linear, with extrapolation at the ends.
    """
    if len(known) == 1:
        return np.ones((len(queries), 1))
    piece = np.clip(np.searchsorted(known, queries) - 1, 0, len(known) - 2)
    fraction = (queries - known[piece]) / (known[piece + 1] - known[piece])
    out = np.zeros((len(queries), len(known)))
    query_index = np.arange(len(queries))
    out[query_index, piece], out[query_index, piece + 1] = 1.0 - fraction, fraction
    return out
