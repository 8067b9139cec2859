"""Numbers, names and aggregates as KRL writes them."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, TandemError
from planner.post.text import number, plain
from planner.segments import Segment

FloatArray = NDArray[np.float64]

NAME_LENGTH: Final = 24
ANGLE_DECIMALS: Final = 5
"""Decimals of A, B, C of targets in degrees."""
_FRAME_ANGLES: Final = 6
_POLE: Final = 1e-7
"""Below this cosine of B, A and C turn about one axis, and C is 0."""
_ZERO_AXES: Final = ",".join(f"E{i} 0.0" for i in range(1, 7))

_WORDS: Final = """
and anin anout b_and b_exor b_not b_or bool brake c_dis c_ori c_ptp c_spl c_vel case char circ circ_rel
confirm const continue cont cycflag decl def default deffct defdat delay delete direction distance do
else end enddat endfct endfor endif endloop endspline endswitch endwhile enum exit exor ext extfct false
flag for frame global goto halt if imp import in inout input int interrupt is ldat lin lin_rel load loop
maximum minimum not off on or out output pdat pos axis e6pos e6axis fdat prio ptp ptp_rel public pulse
real repeat resume return scirc sec seq signal slin spl spline sptp step struc switch sync then timer to
trigger true until var vel wait when while with x y z a b c s t bas home sps cell p00 ir_stopm msglib
user_grp user_saf config krlmsg_t krlmsgpar_t krlmsgopt_t krlmsgdlgsk_t set_krlmsg set_krldlg exists_krlmsg
exists_krldlg clear_krlmsg tm_msg tm_par tm_opt tm_key tm_ticket tm_state tm_answer tm_gone tm_shift tm_turn
"""
RESERVED: Final = frozenset(_WORDS.split())
"""Words of the language, components of its structures, names that every controller has, and those of our own
variables."""


def name(text: str, length: int = NAME_LENGTH) -> str:
    """A name from text, in small letters: letters, digits and single underscores, a letter first, cut to
    ``length``.

    Raises :class:`TandemError` (``post.name``) when that gives no name that KRL takes.
    """
    out = re.sub(r"[^a-z0-9]+", "_", plain(text).lower()).strip("_")[:length].rstrip("_")
    if not re.match(r"[a-z]", out) or out in RESERVED:
        message = f"{text!r} cannot name anything in KRL (it gives {out!r})"
        raise TandemError(Issue("post.name", message, hint="a letter first, no reserved word"))
    return out


def comment(text: str) -> list[str]:
    """Comment lines of plain text, wrapped."""
    return [f"; {line}" for line in textwrap.wrap(plain(text), 100)]


def mark(segment: Segment) -> str:
    """The label by which a comment says which segment begins; names that have more than letters, digits and
    underscores as programs can tell them."""
    label = str(segment)
    return label if re.fullmatch(r"[\w/]+", label, re.ASCII) else segment.key


def abc(rotation: FloatArray) -> FloatArray:
    """KUKA's A, B, C (..., 3) [deg] of rotations (..., 3, 3) = Rz(A) Ry(B) Rx(C); C is 0 where B is +-90."""
    r = np.asarray(rotation, dtype=np.float64)
    flat = np.hypot(r[..., 0, 0], r[..., 1, 0])
    pole = flat < _POLE
    a = np.where(pole, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    b = np.arctan2(-r[..., 2, 0], flat)
    c = np.where(pole, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    return np.asarray(np.rad2deg(np.stack([a, b, c], axis=-1)))


def rotation(degrees: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of KUKA's A, B, C (..., 3) [deg]."""
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    (ca, cb, cc), (sa, sb, sc) = np.moveaxis(cos, -1, 0), np.moveaxis(sin, -1, 0)
    rows = [
        [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
        [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
        [-sb, cb * sc, cb * cc],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def frame(pose: FloatArray, millimetres: int = 4) -> str:
    """A FRAME of (4, 4) [m]: mm with so many decimals, degrees with 6."""
    position = [number(1e3 * v, millimetres) for v in pose[:3, 3]]
    angles = [number(v, _FRAME_ANGLES) for v in abc(pose[:3, :3])]
    return aggregate(dict(zip("XYZABC", [*position, *angles], strict=True)))


def e6pos(position: FloatArray, angles: FloatArray, status: int, turn: int) -> str:
    """An E6POS of a position (3,) [mm] and angles (3,) [deg] as targets are written."""
    values = [*(number(v, 4) for v in position), *(number(v, ANGLE_DECIMALS) for v in angles)]
    fields = dict(zip("XYZABC", values, strict=True)) | {"S": str(status), "T": str(turn)}
    return f"{aggregate(fields)[:-1]},{_ZERO_AXES}}}"


def e6axis(degrees: FloatArray) -> str:
    """An E6AXIS of the controller's joint values (6,) [deg]."""
    fields = {f"A{i}": number(v, 6) for i, v in enumerate(degrees, 1)}
    return f"{aggregate(fields)[:-1]},{_ZERO_AXES}}}"


def aggregate(fields: Mapping[str, str]) -> str:
    """``{X 1.0,Y 2.0}``"""
    return "{" + ",".join(f"{key} {value}" for key, value in fields.items()) + "}"
