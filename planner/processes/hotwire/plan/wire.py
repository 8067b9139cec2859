"""One wire or strip at its working temperature: what it weighs, how stiff it is, how far it bends, how
long it was cold."""

import dataclasses
import math
from typing import Literal

from planner.catalogue.materials import WireMaterial, wire_material
from planner.geometry.units import GRAVITY, MM, measurement
from planner.issues import Issue, TandemError
from planner.processes.hotwire.plan.elastica.clamped import Section, round_section, strip


@dataclasses.dataclass(frozen=True)
class Wire:
    """A wire: ``kind`` round with ``thickness`` = diameter, or strip of ``width`` and ``thickness`` that
    bends the soft way [m].

    ``temperature`` [C] is that of the hot wire. The section is the cold one (heat widens it by less than
    1 %)."""

    material: WireMaterial
    kind: Literal["round", "strip"]
    width: float
    thickness: float
    temperature: float

    @property
    def young(self) -> float:
        """Young's modulus [Pa] of the hot wire."""
        return self.material.young(self.temperature)

    @property
    def area(self) -> float:
        """Cross-section [m^2]."""
        full = self.width * self.thickness
        return math.pi / 4.0 * full if self.kind == "round" else full

    @property
    def bending(self) -> float:
        """EI [N m^2] of the soft way, in the plane of the shape."""
        if self.kind == "round":
            return self.young * math.pi * self.thickness**4 / 64.0
        return self.young * self.width * self.thickness**3 / 12.0

    @property
    def torsion(self) -> float:
        """GJ [N m^2]."""
        return self.bending * self.section.torsion

    @property
    def section(self) -> Section:
        """Stiffness ratios for stability out of the plane."""
        if self.kind == "round":
            return round_section(self.material.poisson)
        return strip(self.width / self.thickness, self.material.poisson)

    @property
    def weight(self) -> float:
        """Weight per length [N/m]."""
        return self.material.density * self.area * GRAVITY

    @property
    def load(self) -> float:
        """Weight per length over EI [1/m^3]: the size of q in `heavy`; times the unit vector of gravity
        it is q."""
        return self.weight / self.bending

    @property
    def min_bend_radius(self) -> float:
        """Smallest radius [m] of the wire's axis without lasting bend: half the thickness over the
        elastic strain."""
        return 0.5 * self.thickness / self.material.elastic_strain

    @property
    def max_curvature(self) -> float:
        """1 / min_bend_radius [1/m]."""
        return 1.0 / self.min_bend_radius

    @property
    def elongation(self) -> float:
        """Thermal elongation per cold length."""
        return self.material.thermal_strain(self.temperature)

    def cold_length(self, hot_length: float) -> float:
        """Length [m] to cut at 20 C for a hot length [m]."""
        return hot_length / (1.0 + self.elongation)

    @property
    def resistance(self) -> float:
        """Resistance per length [ohm/m] of the hot wire."""
        return self.material.resistivity_at(self.temperature) / self.area


def make(
    material: str,
    diameter_mm: float | None = None,
    width_mm: float | None = None,
    thickness_mm: float | None = None,
    temperature_c: float = 20.0,
) -> Wire:
    """A round wire of diameter_mm, or a strip of width_mm and thickness_mm, at temperature_c.

    Raises `TandemError`: wire.unknown_material, wire.size, wire.temperature.
    """
    data = wire_material(material)
    issues = []
    kind: Literal["round", "strip"] = "round" if diameter_mm is not None else "strip"
    sizes = (diameter_mm, diameter_mm) if kind == "round" else (width_mm, thickness_mm)
    both = diameter_mm is not None and (width_mm is not None or thickness_mm is not None)
    width, thickness = (float(s) if s is not None else math.nan for s in sizes)
    good = math.isfinite(width) and math.isfinite(thickness) and 0.0 < thickness <= width
    if both or not good:
        text = (
            f"wire size: got diameter {diameter_mm}, width {width_mm}, thickness {thickness_mm} mm, "
            "allowed either a diameter, or a width and a thickness not above it, all above 0"
        )
        issues.append(Issue("wire.size", text, hint="give diameter_mm, or width_mm and thickness_mm"))
    if not (0.0 <= temperature_c <= data.limit_temperature):
        allowed = f"allowed 0 to {data.limit_temperature:.0f} C for {material}"
        text = f"wire temperature: got {temperature_c:.0f} C, {allowed}"
        issues.append(
            Issue(
                "wire.temperature",
                text,
                **measurement(temperature_c, data.limit_temperature, "C"),
                hint="cut cooler, or take another material",
            )
        )
    if issues:
        raise TandemError(issues)
    return Wire(data, kind, width * MM, thickness * MM, float(temperature_c))
