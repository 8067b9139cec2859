"""Words of KRL: names that nothing may take, settings that a program may make, and their ranges.

System variables and their units (m/s, deg/s, mm, deg, percent): KUKA's expert manual as cited in public posts
and grammars; docs/krl.md says which of them were seen where.
"""

from __future__ import annotations

from typing import Final, NamedTuple

NAME_LENGTH: Final = 24
LINE_LENGTH: Final = 200

_WORDS = """
and b_and b_exor b_not b_or bool brake c_dis c_ori c_ptp c_spl c_vel case channel char circ circ_rel const
continue ccontinue cwrite decl def default defdat defdt deffct delay distance do else end enddat endfct endfor
endif endloop endspline endswitch endwhile enum exit exor ext extfct fals false for frame global goto halt if
import int interrupt is joint lin lin_rel loop maximum minimum not or p path pos priority private ptp ptp_rel
public pulse real repeat resume return scirc sec signal slin spl spline sptp sref stop struc switch then
time_block to trigger true until wait when while with e6pos e6axis axis load load_data
tool_data base_data main bas ir_stopm krlmsg_t krlmsgpar_t krlmsgopt_t krlmsgdlgsk_t set_krlmsg set_krldlg
exists_krlmsg exists_krldlg clear_krlmsg tm_msg tm_par tm_opt tm_key tm_ticket tm_state tm_answer tm_gone
tm_shift tm_turn
"""
RESERVED: Final = frozenset(_WORDS.split())
"""Words of the language, names of its own routines and types, and those of our variables."""


class Range(NamedTuple):
    """Values that a setting may have; ``whole``: numbers without decimals only."""

    low: float
    high: float
    whole: bool = False


MOVING: Final = {
    "$vel.cp": Range(1e-6, 3.0),
    "$vel.ori1": Range(0.01, 1000.0),
    "$vel.ori2": Range(0.01, 1000.0),
    "$apo.cdis": Range(1e-4, 1000.0),
    "$apo.cori": Range(1e-4, 180.0),
}
"""Settings of files with moves; each of these files makes all of them before its first move."""
AXES: Final = tuple(f"$vel_axis[{axis}]" for axis in range(1, 7))
NUMBERS: Final = {**MOVING, **dict.fromkeys(AXES, Range(1.0, 100.0, True))}
"""All settings that are numbers."""
CHOICES: Final = {"$ipo_mode": ("#base",), "$ori_type": ("#var",), "$advance": ("3",)}
"""Settings with the values that are understood: tools in hand, turns at a constant rate, and an advance run,
without which each corner is a stop."""
FRAMES: Final = {"$tool": "frame", "$base": "frame", "$load": "load"}
"""Settings that name data, with their type."""
WORLD: Final = "b_world"
"""What the frame is called that is the cell's world, as the robot's foot sees it."""
FOOT_SHIFT: Final = 0.1
FOOT_TURN: Final = 0.02
"""How far $ROBROOT may be off zero: its way [mm], and the sum of its angles [deg]."""
SPLINE_MOVE: Final = "SPL"
"""What moves of a spline block are called in steps."""
