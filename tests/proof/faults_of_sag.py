"""Faults in sag compensation: signs, arms, stiffness, payload, forces, frames."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from tests.proof.planner_faults import Fault, change_fields, result


def _negate(deflection: Any) -> Any:
    return -deflection


def _change_deflection(change: Any) -> dict[str, Any]:
    """What the loads turn the joints by is another for the planner."""
    return {"motion.sag:joint_deflection": result(change)}


def _standing(change: Any) -> dict[str, Any]:
    """Arms as the planner has them bend, by name, are others."""
    return {"motion.sag:_loaded_arms": result(change)}


def _claims(change: Any) -> Any:
    """What a claim of sag says is another, for the planner and in what is claimed."""
    return {"cell.sag:sag_claims": result(lambda made: tuple(change(claim) for claim in made))}


def _unbent(name: str) -> Any:
    """One arm is left out."""

    def change(arms: Any) -> Any:
        return {**arms, name: dataclasses.replace(arms[name], claim=None)}

    return change


def _swapped(arms: Any) -> Any:
    """Each arm has the other one's joints to bend."""
    one, other = arms
    joints = {one: arms[other].claim.joints * 1.3, other: arms[one].claim.joints * 1.3}
    return {
        name: change_fields(own, claim=lambda c, name=name: dataclasses.replace(c, joints=joints[name]))
        for name, own in arms.items()
    }


def _each(**changes: Any) -> Any:
    """A figure of each arm's claim is another for the planner alone."""

    def change(arms: Any) -> Any:
        return {
            name: own
            if own.claim is None
            else change_fields(own, claim=lambda c: change_fields(c, **changes))
            for name, own in arms.items()
        }

    return change


def _delay(load_fraction: Any) -> Any:
    """The force is taken to come on one target later."""
    return np.concatenate([[0.0], load_fraction[:-1]])


_OTHER: Final = {"stock": "tool", "tool": "stock"}


def _forced(change: Any) -> dict[str, Any]:
    """The force of the work is another for the planner alone."""
    return _standing(lambda arms: {name: change_fields(own, force=change) for name, own in arms.items()})


def _feeds(change: Any) -> dict[str, Any]:
    """The feed goes elsewhere for the planner."""
    return {"motion.sag:feed_directions": result(lambda feed: change_fields(feed, at=change))}


def _to_the_left(axes: Any) -> Any:
    """The feed's axes are turned by a right angle about the tool's."""
    return np.stack([-axes[..., 1], axes[..., 0], axes[..., 2]], axis=-1)


FAULTS: Final = (
    Fault("sag_wrong_sign", "posed_sag", _change_deflection(_negate)),
    Fault("sag_not_made_up_for", "posed_sag", _change_deflection(lambda way: 0.0 * way)),
    Fault("sag_one_arm_left_out", "posed_sag", _standing(_unbent("right"))),
    Fault("sag_stiffness_of_another_robot", "posed_sag", _standing(_swapped)),
    Fault("sag_mass_of_another_tool", "posed_sag", _standing(_each(mass=lambda mass: mass + 2.0))),
    Fault(
        "sag_centre_of_gravity_off",
        "posed_sag",
        _standing(_each(cog=lambda cog: np.add(cog, [0.0, 0.2, 0.4]))),
    ),
    Fault("sag_without_weight", "held_sag", _standing(_each(mass=lambda mass: 0.0 * mass))),
    Fault("sag_force_left_out", "posed_sag", _standing(_each(force=lambda force: 0.0 * force))),
    Fault("sag_force_in_the_other_frame", "posed_sag", _standing(_each(frame=_OTHER.get))),
    Fault("sag_force_late", "posed_sag", {"motion.sag:force_fractions": result(_delay)}),
    Fault("sag_wrong_sign_krl", "posed_sag_krl", _change_deflection(_negate)),
    Fault("sag_wrong_sign_formed", "dsif_sag", _change_deflection(_negate)),
    Fault("sag_one_former_left_out", "dsif_sag", _standing(_unbent("left"))),
    Fault("sag_feed_half_force", "gcode_feed", _forced(lambda force: 0.5 * force)),
    Fault("sag_feed_wrong_sign", "gcode_feed", _forced(np.negative)),
    Fault("sag_feed_wrong_sign_krl", "gcode_feed_krl", _forced(np.negative)),
    Fault("sag_feed_turned", "gcode_feed", {"motion.sag:_feed_axes": result(_to_the_left)}),
    Fault("sag_feed_on_the_other_side", "gcode_feed", _forced(lambda force: force * [1.0, -1.0, 1.0])),
    Fault("sag_feed_of_another_target", "gcode_feed", _feeds(lambda feed: np.roll(feed, 8, axis=0))),
    Fault("sag_feed_of_the_first_target", "gcode_feed", _feeds(lambda feed: 0.0 * feed + feed[1])),
    Fault(
        "sag_claimed_in_the_tool",
        "gcode_feed",
        _claims(lambda c: change_fields(c, frame=lambda frame: "tool")),
    ),
    Fault("sag_table_half_force", "dsif_deep", _forced(lambda force: 0.5 * force)),
    Fault("sag_table_wrong_sign", "dsif_deep", _forced(np.negative)),
    Fault("sag_table_first_row", "dsif_deep", _forced(lambda force: 0.0 * force + force[-1])),
    Fault("sag_table_upside_down", "dsif_deep", _forced(lambda force: force[::-1])),
    Fault(
        "sag_claimed_of_another_depth",
        "dsif_deep",
        _claims(lambda c: change_fields(c, height=lambda z: z + 5e-4)),
    ),
    Fault("sag_table_in_the_tool", "dsif_deep", _standing(_each(frame=_OTHER.get))),
    Fault("sag_claims_left_out", "posed_sag", {"cell.sag:sag_claims": result(lambda made: ())}),
    Fault("sag_claim_of_one_arm", "posed_sag", {"cell.sag:sag_claims": result(lambda made: made[:1])}),
    Fault(
        "sag_claimed_stiffer",
        "posed_sag",
        _claims(lambda c: change_fields(c, joints=lambda joints: 1.2 * joints)),
    ),
    Fault(
        "sag_claimed_payload", "posed_sag", _claims(lambda c: change_fields(c, mass=lambda mass: 0.5 * mass))
    ),
    Fault(
        "sag_claimed_force", "posed_sag", _claims(lambda c: change_fields(c, force=lambda force: 0.9 * force))
    ),
)
