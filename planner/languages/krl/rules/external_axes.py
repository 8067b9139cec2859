"""Recognises the check of an external axis in KRL programs."""

from planner.languages.krl.reader.flow import AXIS_CHECK
from planner.languages.krl.sentences import KRL_AXIS_NOT_HOME
from planner.programs.steps import SettingStep
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import AXIS_VALUE_TOLERANCE, TaskAxis
from planner.proof.rules.external_axes import HOME_TOLERANCES


def checks_axis(context: Context, axis: TaskAxis, step: SettingStep) -> bool:
    """Return whether a step checks that an axis is at home.

    The step must check this axis with a tolerance that is not too large, and in krc4 show the expected text.

    Args:
        context: The proof.
        axis: The external axis.
        step: Step of the program, of any kind.
    """
    if step.kind != AXIS_CHECK:
        return False
    column, home, tolerance = step.values
    text = KRL_AXIS_NOT_HOME.format(unit=axis.label, sign=axis.unit_symbol, home=f"{home:.4f}")
    is_krc4 = context.problem.cell.controller.dialect == "krc4"
    is_same_axis = column == axis.column and abs(axis.scale * home - axis.home) <= AXIS_VALUE_TOLERANCE
    return (
        is_same_axis
        and tolerance <= HOME_TOLERANCES[axis.unit_symbol]
        and step.switches == (text if is_krc4 else "",)
    )
