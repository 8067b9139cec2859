"""Measured test cuts as arrays, the dissertation's tables, and the wire that they were cut with.

`HotWire` is what a kerf needs to know of a wire.
"""

import csv
import dataclasses
import functools
import math
from pathlib import Path
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import refusal
from planner.processes.hotwire.plan.wire import Wire

_DATA_FOLDER: Final = Path(__file__).resolve().parents[4] / "data"
"""Folder of the tables of test cuts."""
TEST_WIRE_LENGTH: Final = 0.43
"""Heated length [m] of the wire in the dissertation's tests."""
TEST_DIAMETER: Final = 0.0004
"""Diameter [m] of that wire."""


@dataclasses.dataclass(frozen=True)
class Cuts:
    """N test cuts in one foam: ``power_per_length`` [W/m], ``speed`` [m/s], ``width`` [m], all (N,)."""

    power_per_length: FloatArray
    speed: FloatArray
    width: FloatArray

    def __len__(self) -> int:
        return len(self.width)

    def only(self, mask: BoolArray) -> "Cuts":
        """The cuts where ``mask`` (N,) is true."""
        return Cuts(self.power_per_length[mask], self.speed[mask], self.width[mask])


@dataclasses.dataclass(frozen=True)
class CutTable:
    """The 32 cells of one foam (N,): ``cuts`` has NaN where the measured value is lost; ``power`` [W],
    ``voltage`` [V], ``calculated`` [m] as printed, ``burnt`` and ``dragging`` as the shading says."""

    cuts: Cuts
    power: FloatArray
    voltage: FloatArray
    calculated: FloatArray
    burnt: BoolArray
    dragging: BoolArray

    @property
    def valid(self) -> BoolArray:
        """(N,) cells that were measured and not burnt."""
        return np.isfinite(self.cuts.width) & ~self.burnt


@functools.lru_cache(maxsize=1)
def dissertation_tables() -> dict[str, CutTable]:
    """The dissertation's tables 2 to 5 by foam."""
    rows = _rows("kerf_cuts.csv")
    return {
        name: _table([row for row in rows if row["foam"] == name]) for name in {r["foam"]: 0 for r in rows}
    }


@functools.lru_cache(maxsize=1)
def air_table() -> dict[str, FloatArray]:
    """Dry air over ``temperature`` [C]: ``density`` [kg/m^3], ``heat`` [J/(kg K)], ``conductivity`` [W/(m
    K)], ``viscosity`` [m^2/s], all (18,)."""
    rows = _rows("kerf_air.csv")

    def column(name: str, unit: float = 1.0) -> FloatArray:
        return np.array([float(row[name]) for row in rows]) * unit

    return {
        "temperature": column("temperature_c"),
        "density": column("density_kg_m3"),
        "heat": column("specific_heat_kj_kg_k", 1e3),
        "conductivity": column("conductivity_w_m_k"),
        "viscosity": column("viscosity_1e6_m2_s", 1e-6),
    }


def _table(rows: list[dict[str, str]]) -> CutTable:
    def column(name: str) -> FloatArray:
        return np.array([float(row[name]) if row[name] else np.nan for row in rows])

    power = column("power_w")
    cuts = Cuts(power / TEST_WIRE_LENGTH, column("speed_mm_s") * MM, column("measured_mm") * MM)
    shading = [row["shading"] for row in rows]
    return CutTable(
        cuts=cuts,
        power=power,
        voltage=column("voltage_v"),
        calculated=column("calculated_mm") * MM,
        burnt=np.array([s.startswith("burnt") for s in shading]),
        dragging=np.array([s.startswith("dragging") for s in shading]),
    )


def _rows(name: str) -> list[dict[str, str]]:
    with (_DATA_FOLDER / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


@dataclasses.dataclass(frozen=True)
class HotWire:
    """A wire of a ``diameter`` [m] and a heated ``length`` [m], over which its power is spread evenly.

    Raises `TandemError` (kerf.input) unless both are finite and above 0.
    """

    diameter: float
    length: float

    def __post_init__(self) -> None:
        for name in ("diameter", "length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                text = f"{name} of the hot wire: got {value / MM:g} mm, allowed above 0"
                raise refusal("kerf.input", text, field=name, hint=f"give the wire's {name}")

    @staticmethod
    def of(wire: Wire, length: float) -> "HotWire":
        """The wire over its heated length [m]; a strip counts by its thickness."""
        return HotWire(wire.thickness, length)


TEST_WIRE: Final = HotWire(TEST_DIAMETER, TEST_WIRE_LENGTH)
"""The wire of the dissertation's test cuts."""
