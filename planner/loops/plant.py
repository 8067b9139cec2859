"""Sheets and robots whose truth is known: what a loop from level to level is tried on.

Nothing of the loop is used here: springback has tables, an interpolation and a law of force of its own. At
each place of a level the command X_c of the tool, the part's depth X after it lets go, and the force F are in
balance:

    X_c = X + S(F) + (1 - compensated) F / k,    F = F_s (1 - exp(-z / z_0)) ((X - X_before) / dz)^m

S from shells of finely meshed sheets (``planner/data/loop_plant.json``, made by ``python -m
bench.plant_shells``) of other thickness, and other hold of the clamp, than the loop believes; or from curves
of the plant's file. Each sheet draws its thickness, clamp, force and stiffness by its own seed. Law of force:
scallops of a ball grow with the square of the step, and force with their 0.09th power (m = 0.18).
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

TABLE: Final = Path(__file__).parents[1] / "data" / "loop_plant.json"
MILLI: Final = 1e-3
"""Millimetres in metres."""
ON_CONTOUR: Final = 3e-3
"""How far [m] a path may be from the contours of a table's shape."""
_HALVINGS: Final = 26
"""Halvings by which a balance is found."""
_STEEPEST: Final = 6.0
"""Steps at once, over the depth between levels, at most: a tool that digs in deeper is not followed."""

Share = Annotated[float, Field(ge=0, le=0.5)]
Span = tuple[Annotated[float, Field(gt=0, le=10)], Annotated[float, Field(gt=0, le=10)]]
Stiff = Annotated[float, Field(ge=0, le=60)]


class CurveFile(Strict):
    """Springback at a depth, as measured on a test piece or assumed."""

    depth_mm: Annotated[float, Field(ge=0, le=1000)]
    forces_n: Annotated[list[Annotated[float, Field(gt=0, le=1e6)]], Field(min_length=1, max_length=50)]
    springback_mm: Annotated[list[Annotated[float, Field(gt=0, le=1000)]], Field(min_length=1, max_length=50)]

    @model_validator(mode="after")
    def _grows(self) -> "CurveFile":
        if len(self.forces_n) != len(self.springback_mm):
            raise ValueError(f"{len(self.forces_n)} forces_n, but {len(self.springback_mm)} springback_mm")
        for row in (self.forces_n, self.springback_mm):
            if any(b <= a for a, b in itertools.pairwise(row)):
                raise ValueError("forces_n and springback_mm have to grow")
        return self


class PlantFile(Strict):
    """A plant: sheets of a table, or of curves, and what forms them. Pairs are the least and the most that
    sheets draw."""

    tandem_plant: Literal[1]
    name: Name = "plant"
    sheet: Literal["cone", "pyramid"] | None = None
    curves: Annotated[list[CurveFile] | None, Field(min_length=1, max_length=100)] = None
    thickness: Annotated[Span, Field(description="over the nominal one")] = (0.91, 0.99)
    thickness_round: Annotated[Share, Field(description="amplitude round the sheet")] = 0.025
    border_n_mm2: Annotated[tuple[Stiff, Stiff], Field(description="spring of the clamp in plane")] = (
        0.0,
        15.0,
    )
    springback: Annotated[Span, Field(description="a factor on all of it")] = (1.0, 1.0)
    force_n: Annotated[float, Field(gt=0, le=1e5, description="steady, along z")] = 620.0
    force_spread: Annotated[Share, Field(description="from sheet to sheet, at most")] = 0.08
    force_round: Annotated[Share, Field(description="amplitude round the sheet")] = 0.05
    force_corner: Annotated[Share, Field(description="by how much more at the middles of corners")] = 0.0
    force_exponent: Annotated[float, Field(gt=0, le=2)] = 0.18
    run_in_mm: Annotated[float, Field(gt=0, le=100)] = 2.5
    stiffness_n_mm: Annotated[
        float, Field(gt=0, le=1e6, description="of the robot with its tool, along z")
    ] = 500.0
    compensated: Annotated[
        tuple[Annotated[float, Field(ge=0, le=2)], Annotated[float, Field(ge=0, le=2)]],
        Field(description="share of the robot's deflection that its controller compensates"),
    ] = (0.9, 0.9)
    noise: Annotated[Share, Field(description="of the force, one standard deviation")] = 0.01
    lift_noise_mm: Annotated[float, Field(ge=0, le=1)] = 0.02

    @model_validator(mode="after")
    def _one_truth(self) -> "PlantFile":
        if (self.sheet is None) == (self.curves is None):
            raise ValueError("give one of sheet and curves")
        for name in ("thickness", "border_n_mm2", "springback", "compensated"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: the least comes first")
        return self


def read_plant(path: Path) -> PlantFile:
    """The plant of a YAML file. Raises `TandemError`: forming.loop_plant for every wrong field, and what
    `strict_yaml.read` raises."""
    return strict_yaml.read_as(PlantFile, path, "forming.loop_plant")


@dataclasses.dataclass(frozen=True)
class Truth:
    """Springback as a table: ``depth`` (D,) [m], ``load`` (L,) [N] from 0, ``value`` (D, W, T, B, L) [m] by
    depth, place (walls, then corners), thickness ``share`` (T,) and ``spring`` (B,) of the clamp [N/mm^2].
    ``core``, ``around`` [m]: half side of the square that contours are around, and how far at the top."""

    depth: FloatArray
    load: FloatArray
    value: FloatArray
    share: FloatArray
    spring: FloatArray
    core: float
    around: float


@functools.cache
def table() -> dict[str, Any]:
    """The table of shells, as its file has it."""
    return dict(json.loads(TABLE.read_text(encoding="utf-8")))


def truth(file: PlantFile) -> Truth:
    """The truth of a plant's file."""
    if file.curves is not None:
        load = np.unique(np.concatenate([[0.0], *(one.forces_n for one in file.curves)]))
        order = sorted(file.curves, key=lambda one: one.depth_mm)
        rows = [np.interp(load, [0.0, *one.forces_n], [0.0, *one.springback_mm]) for one in order]
        value = MILLI * np.array(rows)[:, None, None, None]
        depth = MILLI * np.array([one.depth_mm for one in order])
        return Truth(depth, load, value, np.ones(1), np.zeros(1), np.inf, np.inf)
    found = table()
    shape = found["shapes"][file.sheet]
    value = MILLI * np.array(shape["true_mm"])
    value = np.concatenate([np.zeros((*value.shape[:-1], 1)), value], axis=-1)
    return Truth(
        MILLI * np.array(found["depth_mm"]),
        np.concatenate([[0.0], found["load_n"]]),
        value,
        np.array(found["thickness"]),
        np.array(found["spring_n_mm2"]),
        MILLI * shape["core_mm"],
        MILLI * shape["around_mm"],
    )


def cornered(known: Truth, place: FloatArray) -> FloatArray:
    """How much of a corner's springback places (J, 2) [m] have: 0 at walls, 1 at the middle of a corner."""
    if known.value.shape[1] == 1:
        return np.zeros(len(place))
    over = np.maximum(np.abs(place) - known.core, 0.0)
    turn = np.arctan2(over.min(axis=1), over.max(axis=1))
    return np.asarray(np.sin(2.0 * turn))


def off_contour(known: Truth, place: FloatArray, depth: float) -> float:
    """How far [m] places (J, 2) are at most from the table's contour at a ``depth`` [m], walls of 45 deg."""
    if not np.isfinite(known.around):
        return 0.0
    over = np.maximum(np.abs(place) - known.core, 0.0)
    return float(np.abs(np.hypot(over[:, 0], over[:, 1]) - (known.around - depth)).max())


class Sheets:
    """N sheets of a plant with J places each, that are formed level by level."""

    def __init__(self, file: PlantFile, seeds: FloatArray | list[int], places: FloatArray) -> None:
        """``seeds`` (N,) whole numbers; ``places`` (J, 2) [m] of the first level, seen from above."""
        self._file, self._known, self._places = file, truth(file), places
        self._random = [np.random.default_rng([2002, int(seed)]) for seed in seeds]
        turn = np.arctan2(places[:, 1], places[:, 0])
        rows = [self._drawn(random, turn) for random in self._random]
        self._thick, self._factor, self._steady = (np.stack([row[k] for row in rows]) for k in (0, 1, 2))
        self._spring, self._give = (np.array([row[k] for row in rows])[:, None] for k in (3, 4))
        self.factor: FloatArray = self._factor[:, 0]
        """The factor (N,) on springback that each sheet has drawn."""
        self.depth = np.zeros(self._steady.shape)
        self.force = np.zeros(self._steady.shape)

    def _drawn(
        self, random: np.random.Generator, turn: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
        """Of one sheet: thickness, factor of springback and force by place, spring, 1 / stiffness left."""
        file = self._file
        thick = random.uniform(*file.thickness)
        spring = random.uniform(*file.border_n_mm2)
        factor = random.uniform(*file.springback)
        force = file.force_n * random.uniform(1.0 - file.force_spread, 1.0 + file.force_spread)
        left = 1.0 - random.uniform(*file.compensated)
        phase = random.uniform(0.0, 2.0 * np.pi, 2)
        # sheet is rolled: its thickness and strength have two crests around
        thickness = thick * (1.0 + file.thickness_round * np.cos(2.0 * turn - phase[0]))
        round_force = force * (1.0 + file.force_round * np.cos(2.0 * turn - phase[1]))
        give = left / file.stiffness_n_mm * MILLI
        return thickness, np.full(len(turn), factor), round_force, spring, give

    def curves(self, depth: float, place: FloatArray) -> FloatArray:
        """True S (N, J, L) [m] under the table's loads at a ``depth`` [m] and ``place`` (J, 2) [m]."""
        known = self._known
        at = _weights(known.depth, np.array([depth]))[0]
        value = np.einsum("d,dwtbl->wtbl", at, known.value)
        if len(known.share) > 1:
            spring = _weights(np.sqrt(known.spring), np.sqrt(self._spring[:, 0]))
            value = np.einsum("nb,wtbl->nwtl", spring, value)
            thick = _weights(np.log(known.share), np.log(self._thick.reshape(-1)))
            thick = thick.reshape(*self._thick.shape, -1)
            each = np.einsum("njt,nwtl->njwl", thick, value)
        else:
            # thinner sheets bend more: a curve has no table of that
            each = value[None, None, :, 0, 0] * (self._thick**-1.16)[:, :, None, None]
        corner = cornered(known, place)[:, None]
        mixed = each[:, :, 0] * (1.0 - corner) + each[:, :, -1] * corner
        return np.asarray(mixed * self._factor[:, :, None])

    def form(self, depth: float, step: float, command: FloatArray, place: FloatArray) -> BoolArray:
        """Form a level: ``depth`` [m] wanted, ``step`` [m] from the level before, ``command`` (N, J) [m] of
        the tools below the flat, ``place`` (J, 2) [m]. Afterwards `depth` and `force` are those of the level;
        comes back: where tools had no contact (N, J)."""
        file, curve = self._file, self.curves(depth, place)
        most = self._steady * (1.0 + file.force_corner * cornered(self._known, place))
        most = most * (1.0 - np.exp(-depth / (file.run_in_mm * MILLI)))
        before: FloatArray = self.depth
        low, high = np.zeros(before.shape), np.full(before.shape, _STEEPEST * step)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            force = most * (middle / step) ** file.force_exponent
            over = before + middle + self._springback(curve, force) + self._give * force > command
            low, high = np.where(over, low, middle), np.where(over, middle, high)
        self.depth = before + low
        self.force = np.where(low > 0.0, most * (low / step) ** file.force_exponent, 0.0)
        return np.asarray(low <= 0.0)

    def springback(self, depth: float, place: FloatArray, force: FloatArray) -> FloatArray:
        """True S (N, J) [m] at a ``depth`` [m] and ``place`` (J, 2) [m] under ``force`` (N, J) [N]."""
        return self._springback(self.curves(depth, place), force)

    def _springback(self, curve: FloatArray, force: FloatArray) -> FloatArray:
        """S (N, J) by curves (N, J, L): straight in F^0.6; the last piece goes on."""
        load = self._known.load**0.6
        x = force**0.6
        row = np.clip(np.searchsorted(load, x) - 1, 0, len(load) - 2)
        share = (x - load[row]) / (load[row + 1] - load[row])
        low, high = (np.take_along_axis(curve, (row + k)[..., None], axis=-1)[..., 0] for k in (0, 1))
        return np.asarray(low + share * (high - low))

    def measured(self) -> FloatArray:
        """Force (N, J) [N] of the level as a sensor tells it."""
        noise = self._noise()
        return np.asarray(np.maximum(self.force * (1.0 + self._file.noise * noise), 0.0))

    def lifted(self, depth: float, place: FloatArray) -> FloatArray:
        """How far (N, J) [m] the sheet comes back where the tool is lifted, as it is measured."""
        true = self.springback(depth, place, self.force)
        noise = self._file.lift_noise_mm * MILLI * self._noise()
        return np.asarray(np.maximum(true + noise, 0.0))

    def _noise(self) -> FloatArray:
        count = len(self._places)
        return np.stack([random.normal(size=count) for random in self._random])


def _weights(known: FloatArray, wanted: FloatArray) -> FloatArray:
    """Weights (W, K) of values at ``known`` (K,) for ``wanted`` (W,): linear, the ends go on."""
    if len(known) == 1:
        return np.ones((len(wanted), 1))
    row = np.clip(np.searchsorted(known, wanted) - 1, 0, len(known) - 2)
    share = (wanted - known[row]) / (known[row + 1] - known[row])
    out = np.zeros((len(wanted), len(known)))
    lines = np.arange(len(wanted))
    out[lines, row], out[lines, row + 1] = 1.0 - share, share
    return out
