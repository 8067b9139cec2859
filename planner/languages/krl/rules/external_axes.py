"""The look of KRL programs at external axes."""

from planner.languages.krl.reader.flow import AXIS_LOOK
from planner.languages.krl.sentences import KRL_AXIS_AWAY
from planner.programs.steps import SettingStep
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import SAME_VALUE, OuterAxis
from planner.proof.rules.external_axes import OFF_HOME


def looks_at(context: Context, axis: OuterAxis, step: SettingStep) -> bool:
    """Return whether a step looks at an axis, at its home, closely enough, and tells the operator."""
    if step.kind != AXIS_LOOK:
        return False
    column, home, most = step.values
    text = KRL_AXIS_AWAY.filled(unit=axis.unit, sign=axis.sign, home=f"{home:.4f}")
    is_krc4 = context.problem.cell.controller.dialect == "krc4"
    here = column == axis.column and abs(axis.scale * home - axis.home) <= SAME_VALUE
    return here and most <= OFF_HOME[axis.sign] and step.switches == (text if is_krc4 else "",)
