"""Sheets and robots with known truth, on which a loop from level to level is tested.

Nothing of the loop is used here: springback has separate tables, interpolation and force law. At each
position of a level the command X_c of the tool, the part's depth X after it releases the sheet, and the force
F are in balance:

    X_c = X + S(F) + (1 - compensated) F / k,    F = F_s (1 - exp(-z / z_0)) ((X - X_before) / dz)^m

S comes from shell models of finely meshed sheets (``planner/data/loop_plant.json``, made by ``python -m
bench.plant_shells``) with another thickness and clamp stiffness than the loop assumes, or from curves of the
plant's file. Each sheet draws its thickness, clamp, force and stiffness by its own seed. Force law: scallops
of a ball grow with the square of the step, and force with their 0.09th power (m = 0.18).
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
"""File of the table of shell results."""
MM_IN_M: Final = 1e-3
"""One millimetre [m]."""
MAX_CONTOUR_DISTANCE_M: Final = 3e-3
"""Maximum distance [m] of a path from the contours of a table's shape."""
_HALVINGS: Final = 26
"""Number of halvings to find a balance."""
_MAX_STEP_RATIO: Final = 6.0
"""Maximum step over the depth between levels. A tool that digs in deeper is not followed."""

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
        TandemError: forming.loop_plant for every invalid field, and what `strict_yaml.read` raises.
    """
    return strict_yaml.read_file(PlantFile, path, "forming.loop_plant")


@dataclasses.dataclass(frozen=True)
class SpringbackTruth:
    """True springback as a table.

    Attributes:
        depth: Depths (D,) [m].
        load: Loads from 0 (L,) [N].
        value: Springback by depth, position (walls, then corners), thickness, clamp spring and load (D, W, T,
            B, L) [m].
        thickness_ratio: Thickness over the nominal one (T,).
        spring: Spring of the clamp (B,) [N/mm^2].
        core: Half side of the square that contours surround [m].
        around: Distance of the contour from the square at the top [m].
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
    """Return the table of shell results as in its file."""
    return dict(json.loads(TABLE_FILE.read_text(encoding="utf-8")))


def plant_truth(file: PlantFile) -> SpringbackTruth:
    """Return the truth of a plant's file."""
    if file.curves is not None:
        load = np.unique(np.concatenate([[0.0], *(one.forces_n for one in file.curves)]))
        order = sorted(file.curves, key=lambda one: one.depth_mm)
        rows = [np.interp(load, [0.0, *one.forces_n], [0.0, *one.springback_mm]) for one in order]
        value = MM_IN_M * np.array(rows)[:, None, None, None]
        depth = MM_IN_M * np.array([one.depth_mm for one in order])
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
    """Return how much of a corner's springback positions (J, 2) [m] have.

    0 at walls, 1 at the middle of a corner.
    """
    if known.value.shape[1] == 1:
        return np.zeros(len(position))
    excess = np.maximum(np.abs(position) - known.core, 0.0)
    angle = np.arctan2(excess.min(axis=1), excess.max(axis=1))
    return np.asarray(np.sin(2.0 * angle))


def contour_distance(known: SpringbackTruth, position: FloatArray, depth: float) -> float:
    """Return the largest distance [m] of positions (J, 2) from the table's contour at a depth.

    Walls are at 45 deg.
    """
    if not np.isfinite(known.around):
        return 0.0
    excess = np.maximum(np.abs(position) - known.core, 0.0)
    return float(np.abs(np.hypot(excess[:, 0], excess[:, 1]) - (known.around - depth)).max())


class PlantSheets:
    """N sheets of a plant with J positions each, formed level by level."""

    def __init__(self, file: PlantFile, seeds: FloatArray | list[int], positions: FloatArray) -> None:
        """Create the sheets.

        Args:
            file: The plant.
            seeds: Integer seeds (N,).
            positions: Positions of the first level in plan view (J, 2) [m].
        """
        self._file, self._known, self._positions = file, plant_truth(file), positions
        self._random = [np.random.default_rng([2002, int(seed)]) for seed in seeds]
        turn = np.arctan2(positions[:, 1], positions[:, 0])
        rows = [self._draw_sheet(random, turn) for random in self._random]
        self._thickness, self._factor, self._steady_force = (
            np.stack([row[k] for row in rows]) for k in (0, 1, 2)
        )
        self._spring, self._compliance = (np.array([row[k] for row in rows])[:, None] for k in (3, 4))
        self.factor: FloatArray = self._factor[:, 0]
        """The factor (N,) on springback that each sheet has drawn."""
        self.depth = np.zeros(self._steady_force.shape)
        self.force = np.zeros(self._steady_force.shape)

    def _draw_sheet(
        self, random: np.random.Generator, turn: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
        """Draw one sheet.

        Returns:
            Thickness, factor of springback and force by position, clamp spring, and remaining compliance of
            the robot.
        """
        file = self._file
        mean_thickness = random.uniform(*file.thickness)
        spring = random.uniform(*file.border_n_mm2)
        factor = random.uniform(*file.springback)
        force = file.force_n * random.uniform(1.0 - file.force_spread, 1.0 + file.force_spread)
        uncompensated = 1.0 - random.uniform(*file.compensated)
        phase = random.uniform(0.0, 2.0 * np.pi, 2)
        # rolled sheet: thickness and strength have two maxima around the sheet
        thickness = mean_thickness * (1.0 + file.thickness_round * np.cos(2.0 * turn - phase[0]))
        round_force = force * (1.0 + file.force_round * np.cos(2.0 * turn - phase[1]))
        compliance = uncompensated / file.stiffness_n_mm * MM_IN_M
        return thickness, np.full(len(turn), factor), round_force, spring, compliance

    def true_curves(self, depth: float, position: FloatArray) -> FloatArray:
        """Return true S (N, J, L) [m] under the table's loads at a depth [m] and positions (J, 2) [m]."""
        known = self._known
        depth_weights = _interpolation_weights(known.depth, np.array([depth]))[0]
        value = np.einsum("d,dwtbl->wtbl", depth_weights, known.value)
        if len(known.thickness_ratio) > 1:
            spring = _interpolation_weights(np.sqrt(known.spring), np.sqrt(self._spring[:, 0]))
            value = np.einsum("nb,wtbl->nwtl", spring, value)
            thick = _interpolation_weights(np.log(known.thickness_ratio), np.log(self._thickness.reshape(-1)))
            thick = thick.reshape(*self._thickness.shape, -1)
            by_corner = np.einsum("njt,nwtl->njwl", thick, value)
        else:
            # thinner sheets spring back more; a curve has no table for this, so an exponent of -1.16 is used
            by_corner = value[None, None, :, 0, 0] * (self._thickness**-1.16)[:, :, None, None]
        corner = corner_fraction(known, position)[:, None]
        mixed = by_corner[:, :, 0] * (1.0 - corner) + by_corner[:, :, -1] * corner
        return np.asarray(mixed * self._factor[:, :, None])

    def form_level(self, depth: float, step: float, command: FloatArray, position: FloatArray) -> BoolArray:
        """Form a level. Afterwards `depth` and `force` are those of the level.

        Args:
            depth: Nominal depth [m].
            step: Depth from the previous level [m].
            command: Depth of the tools below the flat (N, J) [m].
            position: Positions (J, 2) [m].

        Returns:
            Where tools had no contact (N, J).
        """
        file, curve = self._file, self.true_curves(depth, position)
        max_force = self._steady_force * (1.0 + file.force_corner * corner_fraction(self._known, position))
        max_force = max_force * (1.0 - np.exp(-depth / (file.run_in_mm * MM_IN_M)))
        last_depth: FloatArray = self.depth
        low, high = np.zeros(last_depth.shape), np.full(last_depth.shape, _MAX_STEP_RATIO * step)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            force = max_force * (middle / step) ** file.force_exponent
            is_too_deep = (
                last_depth + middle + self._springback_of_curves(curve, force) + self._compliance * force
                > command
            )
            low, high = np.where(is_too_deep, low, middle), np.where(is_too_deep, middle, high)
        self.depth = last_depth + low
        self.force = np.where(low > 0.0, max_force * (low / step) ** file.force_exponent, 0.0)
        return np.asarray(low <= 0.0)

    def true_springback(self, depth: float, position: FloatArray, force: FloatArray) -> FloatArray:
        """Return true S (N, J) [m] at a depth [m] and positions (J, 2) [m] under a force (N, J) [N]."""
        return self._springback_of_curves(self.true_curves(depth, position), force)

    def _springback_of_curves(self, curve: FloatArray, force: FloatArray) -> FloatArray:
        """Return S (N, J) from curves (N, J, L): linear in F^0.6, with the last piece extrapolated."""
        load = self._known.load**0.6
        x = force**0.6
        row = np.clip(np.searchsorted(load, x) - 1, 0, len(load) - 2)
        fraction = (x - load[row]) / (load[row + 1] - load[row])
        low, high = (np.take_along_axis(curve, (row + k)[..., None], axis=-1)[..., 0] for k in (0, 1))
        return np.asarray(low + fraction * (high - low))

    def measured_force(self) -> FloatArray:
        """Return the force (N, J) [N] of the level as measured by a sensor."""
        noise = self._noise()
        return np.asarray(np.maximum(self.force * (1.0 + self._file.noise * noise), 0.0))

    def measured_lift(self, depth: float, position: FloatArray) -> FloatArray:
        """Return how far (N, J) [m] the sheet springs back where the tool is lifted, as measured."""
        true = self.true_springback(depth, position, self.force)
        noise = self._file.lift_noise_mm * MM_IN_M * self._noise()
        return np.asarray(np.maximum(true + noise, 0.0))

    def _noise(self) -> FloatArray:
        count = len(self._positions)
        return np.stack([random.normal(size=count) for random in self._random])


def _interpolation_weights(known: FloatArray, queries: FloatArray) -> FloatArray:
    """Return weights (W, K) of values at ``known`` (K,) for ``queries`` (W,).

    They are linear, with extrapolation at the ends.
    """
    if len(known) == 1:
        return np.ones((len(queries), 1))
    row = np.clip(np.searchsorted(known, queries) - 1, 0, len(known) - 2)
    fraction = (queries - known[row]) / (known[row + 1] - known[row])
    out = np.zeros((len(queries), len(known)))
    lines = np.arange(len(queries))
    out[lines, row], out[lines, row + 1] = 1.0 - fraction, fraction
    return out
